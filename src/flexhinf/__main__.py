"""``python -m flexhinf`` is the command ``flexhinf``."""

import sys

from flexhinf.cli import main

if __name__ == "__main__":
    sys.exit(main())
