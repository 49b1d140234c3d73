"""Hostile and damaged inputs: nothing false is told of them, nothing else is opened, nothing hangs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from moving_clips import FPS, approach, write_clip

TIMES_OF = """
import sys
from ttcvid.sources import open_source
for path in sys.argv[1:]:
    with open_source(path) as source:
        print([frame.t_s for frame in source], source.info.nominal_dt_s)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="MALLOC_PERTURB_ is glibc's")
def test_times_do_not_come_from_memory_that_is_free(tmp_path: Path) -> None:
    clips = [write_clip(tmp_path / name, approach(4)) for name in ("a.mp4", "a.mkv")]
    command = [sys.executable, "-c", TIMES_OF, *map(str, clips)]
    # glibc overwrites what is freed: of a stream that is read after its container was closed only nonsense is left
    environment = {**os.environ, "MALLOC_PERTURB_": "255"}
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout
    assert printed == f"{[i / FPS for i in range(4)]} {1 / FPS}\n" * 2
