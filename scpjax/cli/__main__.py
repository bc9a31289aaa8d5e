"""``python -m scpjax.cli``."""

import sys

from scpjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
