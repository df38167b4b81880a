"""The real command line in a process of its own, with the episode without physics."""

import sys
import types

if __name__ == "__main__":  # worker processes import this file too, and need no more of it
    from tests.scenarios import fake_episode

    sys.modules["pickproof.scenarios.campaign.episode"] = fake_episode
    # it reads no files, and the real work cell takes seconds to import
    no_cell = types.SimpleNamespace(check_inputs=lambda scenario, oracle: None)
    sys.modules["pickproof.scenarios.picking.workcell"] = no_cell
    from pickproof.scenarios.commands.cli import main

    sys.exit(main())
