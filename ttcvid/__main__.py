"""``python -m ttcvid``: the program ``ttcvid`` of the Python that runs it."""

from ttcvid.cli.main import program

program()
