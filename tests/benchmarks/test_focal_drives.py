"""The simulated cameras of the focal length benchmark."""

import numpy as np
from focal_drives import KINDS, focal_drive

from ttcvid.geometry.estimation.relative_pose import GaussianPrior, fit_motion
from ttcvid.geometry.rotation import vector_from_rotation


def test_a_seed_gives_the_same_clip_again():
    one, other = focal_drive(3), focal_drive(3)
    assert one.focal_px == other.focal_px
    for first, second in zip(one.frames, other.frames, strict=True):
        np.testing.assert_array_equal(first.points.xy_px, second.points.xy_px)


def test_kinds_take_turns_and_clips_differ():
    drives = [focal_drive(seed) for seed in range(len(KINDS))]
    assert tuple(drive.kind for drive in drives) == KINDS
    assert len({drive.focal_px for drive in drives}) == len(KINDS)
    assert all(0.0 <= drive.movers < 0.9 for drive in drives)


def test_a_pan_is_a_rotation_at_its_true_focal_length():
    """Residuals of a rotation are those of the noise, at most 0.3 px; at a third more focal length they are not."""
    drive = focal_drive(0)
    first, last = drive.frames[0].points, drive.frames[20].points
    _, one, other = np.intersect1d(first.track_id, last.track_id, return_indices=True)
    assert residual_px(first.xy_px[one], last.xy_px[other], drive.focal_px) < 0.4
    assert residual_px(first.xy_px[one], last.xy_px[other], 1.33 * drive.focal_px) > 0.6


def residual_px(xy_px: np.ndarray, later_px: np.ndarray, focal_px: float) -> float:
    centred = [np.column_stack([(xy - (399.5, 224.5)) / focal_px, np.ones(len(xy))]) for xy in (xy_px, later_px)]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in centred]
    sigma_rad = np.full(len(xy_px), 0.2 / focal_px)
    prior = GaussianPrior(np.zeros(3), 1.0)
    fit = fit_motion(*rays, sigma_rad, np.zeros(len(xy_px), np.int64), prior, np.eye(3))
    assert np.linalg.norm(vector_from_rotation(fit.cam_R_prev)) > 0.01
    return float(np.median(fit.residual)) * 0.2
