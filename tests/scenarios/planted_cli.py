"""The real command line in a process of its own, with planted episodes."""

import sys

import planted_episode

if __name__ == "__main__":
    sys.modules["scenarios.episode"] = planted_episode
    import scenarios.workcell
    from scenarios.cli import main

    scenarios.workcell.check_inputs = lambda scenario, oracle: None  # a planted episode reads no files

    sys.exit(main())
