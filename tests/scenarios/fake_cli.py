"""The real command line in a process of its own, with the episode without physics."""

import sys

if __name__ == "__main__":  # worker processes import this file too, and need no more of it
    from tests.scenarios import fake_episode

    sys.modules["scenarios.episode"] = fake_episode
    import scenarios.workcell
    from scenarios.cli import main

    scenarios.workcell.check_inputs = lambda scenario, oracle: None  # the episode without physics reads no files

    sys.exit(main())
