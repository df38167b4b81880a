"""`python -m pickproof`."""

import sys

from pickproof.scenarios.commands.cli import main

if __name__ == "__main__":
    sys.exit(main())
