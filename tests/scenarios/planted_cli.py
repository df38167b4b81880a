"""The real command line in a process of its own, with planted episodes."""

import sys
import types

from tests.scenarios import planted_episode
from tests.scenarios.in_process import episodes_in_this_process

if __name__ == "__main__":
    sys.modules["pickproof.scenarios.campaign.episode"] = planted_episode
    # a planted episode reads no files, and the real work cell takes seconds to import
    sys.modules["pickproof.scenarios.picking.workcell"] = types.SimpleNamespace(
        check_inputs=lambda scenario, oracle: None
    )
    from pickproof.scenarios.commands.cli import main

    episodes_in_this_process()

    sys.exit(main())
