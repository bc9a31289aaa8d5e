"""``python -m scpjax``: the command line, where its script is not on the path."""

import sys

from scpjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
