"""``python -m scpjax``: the command line, where its script is not on the path."""

import sys

from scpjax.cli import main

sys.exit(main())
