"""The gallery: its page shows every frame that its command draws, and no other."""

import re
from pathlib import Path

from gallery import DRAWINGS, EXHIBITS

PAGE = DRAWINGS.with_suffix(".md")


def test_the_page_shows_every_drawing_and_says_what_is_right_and_wrong_in_it():
    parts = re.split(r"^!\[frame \d+\]", PAGE.read_text(), flags=re.MULTILINE)[1:]
    shown = [re.match(r"\(gallery/(\w+)\.png\)", part).group(1) for part in parts]
    assert shown == [f"{name}_{frame}" for name, exhibit in EXHIBITS.items() for frame in exhibit.frames]
    assert sorted(path.stem for path in DRAWINGS.glob("*.png")) == sorted(shown)
    for part in parts:
        assert " Right: " in part.replace("\n", " ")
        assert " Wrong: " in part.replace("\n", " ")


def test_drawings_are_small():
    assert max(path.stat().st_size for path in Path(DRAWINGS).glob("*.png")) < 60_000
