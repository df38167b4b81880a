"""The real command line in a process of its own, with the episode without physics."""

import sys

if __name__ == "__main__":  # worker processes import this file too, and need no more of it
    from tests.scenarios import fake_episode

    sys.modules["pickproof.scenarios.campaign.episode"] = fake_episode
    import pickproof.scenarios.picking.workcell
    from pickproof.scenarios.commands.cli import main

    pickproof.scenarios.picking.workcell.check_inputs = lambda scenario, oracle: (
        None
    )  # the episode without physics reads no files

    sys.exit(main())
