"""`python -m imumon`: the command line."""

import sys

from imumon.cli import main

if __name__ == "__main__":
    sys.exit(main())
