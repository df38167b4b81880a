"""The real command line in a process of its own, with the episode without physics."""

import sys

import fake_episode

if __name__ == "__main__":
    sys.modules["scenarios.episode"] = fake_episode
    from scenarios.cli import main

    sys.exit(main())
