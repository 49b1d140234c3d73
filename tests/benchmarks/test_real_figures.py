"""What is found of boxes drawn by eye, and what false warnings of real drives are said."""

import numpy as np
import pandas as pd
from real_clips.clips import CLIPS, DASHCAM
from real_clips.judging import BOXES, boxes_of, judge_boxes

from ttcvid.studies.evaluation.truth import BOX, RunTables


def run_of(objects: pd.DataFrame) -> RunTables:
    """A run of frames 0-9 with these objects."""
    frames = pd.DataFrame({"frame": range(10), "t_s": 0.1 * np.arange(10)})
    clusters = objects.assign(role="object", cluster_id=range(len(objects)))
    return RunTables(frames, clusters, pd.DataFrame(), pd.DataFrame(), pd.DataFrame())


def test_movers_are_counted_by_size_and_what_lies_on_no_box_is_false():
    drawn = [
        (4, "far walker", 1, 0, 0, 10, 20),
        (4, "car", 1, 100, 100, 200, 200),
        (4, "parked car", 0, 300, 100, 400, 200),
        (8, "car", 1, 100, 100, 150, 150),
        (12, "car", 1, 100, 100, 150, 150),  # after the end of the run
    ]
    boxes = pd.DataFrame(drawn, columns=["frame", "name", "is_mover", *BOX])
    found = [
        (4, 5, 102, 99, 199, 201),  # the car
        (4, 6, 310, 100, 400, 190),  # the parked car: neither right nor wrong
        (4, 7, 500, 0, 560, 60),  # nothing
        (4, 0, 600, 0, 660, 60),  # nothing, but said to be at rest
        (5, 8, 500, 0, 560, 60),  # nobody looked at this frame
    ]
    judged = judge_boxes(run_of(pd.DataFrame(found, columns=["frame", "motion_id", *BOX])), boxes)
    assert judged.n.tolist() == [1, 1, 1]
    assert judged.n_found.tolist() == [0, 0, 1]
    assert (judged.n_false, judged.n_frames) == (1, 2)


def test_boxes_are_of_clips_that_are_analysed_and_are_boxes():
    boxes = pd.read_csv(BOXES)
    assert set(boxes["clip"]) <= {clip.name for clip in CLIPS}
    assert boxes.groupby("clip").frame.nunique().sum() >= 20
    assert boxes["clip"].nunique() >= 4
    assert (boxes.x1_px > boxes.x0_px).all()
    assert (boxes.y1_px > boxes.y0_px).all()
    assert not boxes.duplicated(["clip", "frame", "name"]).any()
    assert boxes_of("highway").empty
    assert set(boxes_of("city_traffic").frame) == {30, 90, 150, 210, 270}


def test_every_drive_is_analysed_as_a_vehicle_and_with_nothing_given():
    settings = {(clip.name, clip.setting) for clip in CLIPS}
    assert {(name, setting) for name in DASHCAM for setting in ("vehicle", "nothing given")} <= settings
    assert all("camera" not in clip.options for clip in CLIPS)
