import json

import pytest

from ttcvid.errors import InputError, OutputError
from ttcvid.sinks.manifest import read_manifest, write_manifest


def test_manifest_comes_back_with_sorted_keys(tmp_path):
    path = tmp_path / "manifest.json"
    write_manifest(path, {"state": "complete", "camera": {"fx_px": 721.5}, "input": "größe.mp4"})
    assert read_manifest(path) == read_manifest(tmp_path)
    assert read_manifest(path)["camera"]["fx_px"] == 721.5
    text = path.read_text(encoding="utf-8")
    assert list(json.loads(text)) == ["camera", "format", "input", "state"]
    assert "größe" in text
    assert [file.name for file in tmp_path.iterdir()] == ["manifest.json"]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_nan_and_infinity_are_refused_and_nothing_is_written(tmp_path, value):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_manifest(tmp_path / "manifest.json", {"fps": value})
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["", "{", "[]", '{"name": "my web app"}', "[" * 100_000])
def test_what_is_not_our_manifest_is_an_input_error_of_one_line(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=r"manifest\.json") as caught:
        read_manifest(tmp_path)
    assert "\n" not in str(caught.value)


def test_folder_without_manifest_is_no_finished_run(tmp_path):
    with pytest.raises(InputError, match="no finished run"):
        read_manifest(tmp_path)


def test_unwritable_place_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        write_manifest(tmp_path / "absent" / "manifest.json", {})
