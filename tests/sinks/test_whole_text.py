"""A text file is written whole or not at all."""

import errno
import os
from pathlib import Path
from typing import BinaryIO

import pytest

from ttcvid.errors import OutputError
from ttcvid.sinks import whole_text
from ttcvid.sinks.whole_text import write_whole


def test_where_the_disk_is_full_the_former_file_stays_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.html"
    page.write_text("former")

    def no_space(path: Path) -> BinaryIO:
        path.write_text("new")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(whole_text, "make_anew", no_space)
    with pytest.raises(OutputError, match=r"page\.html: cannot be written, the disk is full"):
        write_whole(page, "new text")
    assert page.read_text() == "former"
    assert os.listdir(tmp_path) == ["page.html"]


def test_a_link_stays_a_link_and_its_file_is_replaced(tmp_path: Path) -> None:
    real, link = tmp_path / "real.xml", tmp_path / "link.xml"
    real.write_text("former")
    link.symlink_to(real)
    write_whole(link, "new ü")
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == "new ü"


def test_a_pipe_is_written_into(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    write_whole(Path(f"/dev/fd/{writing}"), "words")
    os.close(writing)
    with os.fdopen(reading) as pipe:
        assert pipe.read() == "words"


def test_what_goes_to_a_file_through_an_open_descriptor_goes_to_that_file(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w") as log:
        write_whole(Path(f"/dev/fd/{log.fileno()}"), "page\n")
        assert os.listdir(tmp_path) == ["log"]
        assert os.fstat(log.fileno()).st_size == 5


def test_a_file_that_may_not_be_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.html"
    page.write_text("former")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match=r"page\.html"):
        write_whole(page, "new")
    assert page.read_text() == "former"


def test_a_folder_in_the_way_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_whole(tmp_path, "words")


def test_links_that_go_in_circles_are_told(tmp_path: Path) -> None:
    one, other = tmp_path / "one.html", tmp_path / "other.html"
    one.symlink_to(other)
    other.symlink_to(one)
    with pytest.raises(OutputError, match=r"one\.html: cannot be written"):
        write_whole(one, "words")


def test_who_may_read_and_write_a_file_stays_as_it_was(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("former")
    page.chmod(0o660)
    write_whole(page, "new")
    assert page.read_text() == "new"
    assert page.stat().st_mode & 0o777 == 0o660
