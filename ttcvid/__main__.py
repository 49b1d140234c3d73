"""``python -m ttcvid``: the program ``ttcvid`` of the Python that runs it."""

import sys

from ttcvid.cli.main import main

sys.exit(main())
