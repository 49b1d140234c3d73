"""The truths of real clips are put into our conventions as they are meant."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from truths import frames_of_poses, judge_quiet, real_clips

from ttcvid.studies.evaluation.truth import DIRECTION, ROTATION, RunTables


def tables(n_frames: int) -> RunTables:
    frames = pd.DataFrame({"frame": range(n_frames), "t_s": np.arange(n_frames) * 0.1})
    nothing = pd.DataFrame()
    return RunTables(frames, nothing, nothing, nothing, nothing)


def test_the_scene_comes_towards_a_camera_that_drives_forward_and_turns_right() -> None:
    yaw = 0.02
    turned = np.array([[np.cos(yaw), 0, np.sin(yaw), 0], [0, 1, 0, 0], [-np.sin(yaw), 0, np.cos(yaw), 1.2]])
    poses = np.stack([np.eye(3, 4), turned]).reshape(2, 12)
    row = frames_of_poses(poses, tables(2)).iloc[1]
    # To the right of the old axis is where the new axis looks: a ray ahead of the old camera lies left of the new one.
    assert row[ROTATION].to_numpy(float) == pytest.approx([0, -yaw, 0])
    assert row[DIRECTION].to_numpy(float) == pytest.approx([np.sin(yaw), 0, -np.cos(yaw)])


@pytest.mark.data
def test_every_clip_with_a_truth_is_there(data_dir: Path) -> None:
    clips = real_clips()
    assert len(clips) == len({clip.name for clip in clips}) == 17
    assert sum(clip.judge is judge_quiet for clip in clips) == 1
    for clip in clips:
        assert (data_dir / clip.path).exists()
