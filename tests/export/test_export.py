"""Exports of a run, each read back by the library of its own format."""

import csv
import json
import sys
from collections import Counter
from pathlib import Path

import motmetrics
import numpy as np
import pyarrow.parquet as pq
import pytest
from made_runs import DT_S, SIZE, WARNED_FROM, made_run
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pycocotools.coco import COCO

import ttcvid
from ttcvid.cli.main import main
from ttcvid.errors import InputError, OutputError, UsageError
from ttcvid.schema import TABLE_NAMES

N_FRAMES = 40
BOX = (20.0, 15.0, 20.0, 15.0)
"""Left, top, width and height of every object of a made run."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_run(tmp_path_factory.mktemp("export") / "made", N_FRAMES, has_video=True)


def test_csv_holds_every_row_and_column_of_every_table(run: Path, tmp_path: Path) -> None:
    folder = ttcvid.export(run, "csv", tmp_path / "tables")
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{name}.csv" for name in TABLE_NAMES)
    for name in TABLE_NAMES:
        with (folder / f"{name}.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        table = pq.read_table(run / f"{name}.parquet")
        assert len(rows) == table.num_rows
        assert list(rows[0]) == table.column_names
    with (folder / "frames.csv").open(newline="") as file:
        first, second, *_ = csv.DictReader(file)
    assert (first["dt_s"], first["status"]) == ("", "first")
    assert float(second["rot_y_rad"]) == -0.002


def test_one_table_goes_into_one_file(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(run), "--to", "csv", "--table", "events"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["made_events.csv"]
    assert "collision_course" in (tmp_path / "made_events.csv").read_text()


# Of motmetrics itself, with pandas 3.
@pytest.mark.filterwarnings("ignore:Operation with tuple is deprecated")
def test_motmetrics_reads_the_boxes_where_they_are(run: Path, tmp_path: Path) -> None:
    path = ttcvid.export(run, "mot", tmp_path / "det.txt")
    # It takes the (1, 1) of the format's first pixel off again.
    found = motmetrics.io.loadtxt(str(path), fmt="mot15-2D")
    assert len(found) == 2 * N_FRAMES
    np.testing.assert_allclose(found[["X", "Y", "Width", "Height"]], np.tile(BOX, (2 * N_FRAMES, 1)))
    assert found.index.get_level_values("FrameId").min() == 1
    assert set(found.index.get_level_values("Id")) == {1, 2}


def test_pycocotools_reads_boxes_tracks_and_times(run: Path, tmp_path: Path) -> None:
    coco = COCO(str(ttcvid.export(run, "coco", tmp_path / "objects.json")))
    assert len(coco.getImgIds()) == N_FRAMES
    found = coco.loadAnns(coco.getAnnIds(imgIds=[7]))
    assert [one["track_id"] for one in found] == [1, 2]
    left, top, *size = found[0]["bbox"]
    # The corner of the first pixel is half a pixel from its centre.
    assert (left, top, *size) == (BOX[0] + 0.5, BOX[1] + 0.5, *BOX[2:])
    assert found[0]["ttc_z_s"] == pytest.approx((N_FRAMES - 7) * DT_S + 0.5)
    assert found[0]["ttc_z_lo_s"] == pytest.approx(0.9 * found[0]["ttc_z_s"])
    image = coco.loadImgs([7])[0]
    assert (image["width"], image["height"], image["t_s"]) == (SIZE.width_px, SIZE.height_px, pytest.approx(0.7))
    assert [track["id"] for track in coco.dataset["tracks"]] == [1, 2]


def test_rerun_reads_video_tracks_boxes_epipoles_and_times_on_one_timeline(run: Path, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    path = ttcvid.export(run, "rrd", tmp_path / "run.rrd")
    columns: dict[tuple[str, str], list] = {}
    for chunk in RrdReader(str(path)).stream():
        for name, values in chunk.to_record_batch().to_pydict().items():
            columns.setdefault((chunk.entity_path, name), []).extend(values)
    boxes = columns["/camera/image/boxes", "Boxes2D:centers"]
    assert boxes == [[[30.0, 22.5], [30.0, 22.5]]] * N_FRAMES
    assert columns["/camera/image/boxes", "Boxes2D:class_ids"][0] == [1, 2]
    assert columns["/camera/image/tracks", "Points2D:positions"][3] == [[30.0, 24.0]]
    assert columns["/camera/image/tracks", "Points2D:class_ids"][3] == [1]
    assert [len(points) for points in columns["/camera/image/epipoles", "Points2D:positions"]] == [3] * N_FRAMES
    times = columns["/times/object_1/ttc_z_s", "time"]
    values = columns["/times/object_1/ttc_z_s", "Scalars:scalars"]
    assert [time.total_seconds() for time in times] == pytest.approx(np.arange(N_FRAMES) * DT_S)
    assert [value for (value,) in values] == pytest.approx((N_FRAMES - np.arange(N_FRAMES)) * DT_S + 0.5)
    assert ("/times/object_1/ttc_z_hi_s", "Scalars:scalars") in columns
    assert len(columns["/camera/image/video", "VideoFrameReference:timestamp"]) == N_FRAMES
    assert ("/camera/image/video", "AssetVideo:blob") in columns
    assert columns["/warnings", "TextLog:text"] == [
        ["collision course of object 1"],
        ["end of collision course of object 1"],
    ]


def test_mcap_reads_messages_of_foxglove_with_their_times(run: Path, tmp_path: Path) -> None:
    path = ttcvid.export(run, "mcap", tmp_path / "run.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        schemas = {(channel.topic, schema.name) for schema, channel, _ in reader.iter_messages()}
        protobuf = ["/annotations", "/camera/video", "/camera/calibration", "/warnings"]
        decoded = [
            (one.channel.topic, one.message, one.decoded_message) for one in reader.iter_decoded_messages(protobuf)
        ]
        objects = [json.loads(message.data) for _, _, message in reader.iter_messages(["/objects/1"])]
    assert {
        ("/annotations", "foxglove.ImageAnnotations"),
        ("/camera/video", "foxglove.CompressedVideo"),
        ("/camera/calibration", "foxglove.CameraCalibration"),
        ("/warnings", "foxglove.Log"),
        ("/objects/1", "ttcvid.Object"),
    } <= schemas
    count = Counter(topic for topic, _, _ in decoded)
    assert count == {"/annotations": N_FRAMES, "/camera/video": N_FRAMES, "/camera/calibration": 1, "/warnings": 2}
    (begin, _) = [message for topic, message, _ in decoded if topic == "/warnings"]
    assert begin.log_time == pytest.approx(WARNED_FROM * DT_S * 1e9)
    annotations = next(content for topic, _, content in decoded if topic == "/annotations")
    tracks, first_box, _ = annotations.points
    assert [(point.x, point.y) for point in tracks.points] == [(30.0, 24.0)]
    assert [(point.x, point.y) for point in first_box.points] == [(20, 15), (40, 15), (40, 30), (20, 30)]
    assert [text.text for text in annotations.texts] == ["1 4.5 s", "2 4.5 s"]
    video = next(content for topic, _, content in decoded if topic == "/camera/video")
    assert video.format == "h264"
    assert video.data.startswith(b"\0\0\0\1")
    assert objects[5]["ttc_z_s"] == pytest.approx((N_FRAMES - 5) * DT_S + 0.5)
    assert objects[5]["frame"] == 5


@pytest.mark.parametrize("to", ["csv", "mot", "coco", "rrd", "mcap"])
def test_a_run_in_which_nothing_was_found_can_be_exported(to: str, tmp_path: Path) -> None:
    path = ttcvid.export(made_run(tmp_path / "run", 3, n_objects=0), to, tmp_path / f"out.{to}")
    assert path.exists()


def test_what_exists_is_replaced_only_when_told(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    path.write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        ttcvid.export(run, "mot", path)
    assert path.read_text() == "mine"
    ttcvid.export(run, "mot", path, overwrite=True)
    assert path.read_text() != "mine"
    assert [entry.name for entry in tmp_path.iterdir()] == ["det.txt"]
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables/notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        ttcvid.export(run, "csv", tmp_path / "tables")
    ttcvid.export(run, "csv", tmp_path / "tables", overwrite=True)
    assert (tmp_path / "tables/notes.txt").read_text() == "mine"


def test_what_cannot_be_exported_is_refused_with_a_reason(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="--to = 'pdf': expected one of csv, mot, coco, rrd, mcap"):
        ttcvid.export(run, "pdf")
    with pytest.raises(UsageError, match="expected one of collision_times"):
        ttcvid.export(run, "csv", table="objects")
    with pytest.raises(UsageError, match="--table is for --to csv"):
        ttcvid.export(run, "mot", table="frames")
    with pytest.raises(InputError, match="no finished run"):
        ttcvid.export(tmp_path, "mot")
    with pytest.raises(OutputError, match="its folder does not exist"):
        ttcvid.export(run, "mot", tmp_path / "nowhere/det.txt")
    without = made_run(tmp_path / "without")
    (without / "clusters.parquet").unlink()
    for to in ("csv", "mot"):
        with pytest.raises(InputError, match=r"clusters\.parquet: cannot be read as a table"):
            ttcvid.export(without, to)
    assert [path.name for path in tmp_path.iterdir()] == ["without"]
    assert main(["export", str(tmp_path), "--to", "mot"]) == 3
    assert main(["export", str(run), "--to", "pdf"]) == 2
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.parametrize(("to", "module"), [("rrd", "rerun"), ("mcap", "mcap.writer")])
def test_a_library_that_is_missing_is_named_with_how_to_get_it(
    to: str, module: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=rf"pip install 'ttcvid\[{to}\]'"):
        ttcvid.export(run, to, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
