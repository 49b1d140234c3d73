"""Whatever is written in YAML is read by one strict reader, and answered by one short line."""

import pytest

from ttcvid.calibration import read_camera
from ttcvid.errors import TtcvidError
from ttcvid.jobs.compare.baseline import read_baseline
from ttcvid.jobs.compare.compare_runs import read_tolerance
from ttcvid.jobs.regress.suite import read_suite
from ttcvid.model import ImageSize
from ttcvid.simulate import load_scene
from ttcvid.strict_yaml import load_yaml

READERS = {
    "camera": lambda path: read_camera(path, ImageSize(640, 360)),
    "scene": load_scene,
    "baseline": read_baseline,
    "tolerances": read_tolerance,
    "suite": read_suite,
}
LONGEST_MESSAGE = 600
BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 24))


def refused(kind, path, text):
    path.write_text(text)
    with pytest.raises(TtcvidError) as caught:
        READERS[kind](path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < LONGEST_MESSAGE + len(str(path))
    return message


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "line 2"),
        ("name: a\nname: b\n", "key 'name' is given twice"),
        ("name: !!python/object/apply:os.getcwd []\n", "the tag"),
        ("[" * 1000, "YAML"),
        ("name: " + "x" * 2_000_000, "kB of YAML"),
    ],
    ids=["aliases", "twice", "tag", "deep", "long"],
)
def test_hostile_yaml_is_one_short_line(kind, text, says, tmp_path):
    message = refused(kind, tmp_path / "a.yaml", text)
    assert kind in ("camera", "baseline") or says in message  # those two have limits and words of their own


@pytest.mark.parametrize("kind", READERS)
def test_a_long_value_is_quoted_in_short(kind, tmp_path):
    refused(
        kind, tmp_path / "a.yaml", f"name: {'x' * 100_000}\ncamera: [{'y, ' * 5000}]\nschema_version: {'z' * 9000}\n"
    )


def test_small_numbers_are_numbers():
    assert load_yaml("a: 1e-05\nb: [1, two]\n") == {"a": 1e-5, "b": [1, "two"]}
