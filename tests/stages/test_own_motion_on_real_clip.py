"""A car that creeps up to a red light: an essential matrix invents turns there, own motion does not.

The street is straight and so is the way: yaw is known to be within 0.1 deg a frame (the lead car, the lane and the
houses keep their places in the picture), and the direction is that of the optical axis within some degrees.
"""

import cv2
import numpy as np
import pytest

from ttcvid.calibration import read_camera
from ttcvid.config import EgomotionConfig, TrackingConfig
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.rotation import normalize, vector_from_rotation
from ttcvid.model import ImageSize, Platform
from ttcvid.stages.egomotion.frame_gap import find_own_motion
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory
from ttcvid.stages.tracking.history import empty_history, extended
from ttcvid.stages.tracking.tracker import TrackerMemory, follow_points, prepare_picture

FRAMES = range(14, 51)
FRAME_RATE_HZ = 9.6525
# Thresholds in px that people use with features: OpenCV's default and twice that.
RANSAC_PX = (1.0, 2.0)


@pytest.fixture(scope="module", params=["klt", pytest.param("akaze", marks=pytest.mark.exhaustive)])
def motions(request, data_dir):
    """Of each step, ours and the essential matrix's over the same tracks: yaw, angle from forward; in deg."""
    folder = data_dir / "kitti_sfnd_ttc"
    camera = read_camera(folder / "calib.txt", ImageSize(1242, 375))
    config = TrackingConfig(tracker=request.param)
    history, memory, last = empty_history(camera, config.sigma_start_px), EgomotionMemory(), None
    tracker, ours, essential = TrackerMemory(), [], []
    for frame in FRAMES:
        grey = cv2.imread(str(folder / "image_02" / f"{frame:010d}.png"), cv2.IMREAD_GRAYSCALE)
        points, _, tracker = follow_points(tracker, prepare_picture(grey, None, config), None, config)
        rays = normalize(rays_from_pixels(camera, points.xy_px))
        history = extended(history, frame, frame / FRAME_RATE_HZ, points, rays, 11)
        egomotion, history, memory = find_own_motion(
            history,
            np.ones(history.n_tracks, dtype=bool),
            np.ones(history.n_tracks, dtype=bool),
            memory,
            EgomotionConfig(platform=Platform.vehicle),
            0.25,
            config.sigma_floor_px,
        )
        if last is not None:
            away = np.nan if egomotion.direction is None else np.degrees(np.arccos(-egomotion.direction[2]))
            ours.append((np.degrees(egomotion.rotation_rad[1]), away))
            essential.append([essential_motion(last, points, camera, limit_px) for limit_px in RANSAC_PX])
        last = points
    return np.array(ours), np.array(essential)


def essential_motion(last, points, camera, limit_px):
    """Yaw, angle from forward (deg) and the inliers' share of the usual recipe: RANSAC over five points."""
    _, one, other = np.intersect1d(last.track_id, points.track_id, return_indices=True)
    first, second = last.xy_px[one], points.xy_px[other]
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    E, inliers = cv2.findEssentialMat(first, second, K, cv2.RANSAC, 0.999, limit_px)
    _, R, t, _ = cv2.recoverPose(E[:3], first, second, K, mask=inliers.copy())
    away = np.degrees(np.arccos(np.clip(abs(t[2, 0]), 0, 1)))
    return np.degrees(vector_from_rotation(R)[1]), away, inliers.mean()


@pytest.mark.data
@pytest.mark.slow
def test_an_essential_matrix_invents_a_turn_and_nearly_all_points_agree(motions):
    _, essential = motions
    yaw_deg, away_deg, inliers = np.moveaxis(essential, -1, 0)
    invented = np.abs(yaw_deg) > 0.5
    assert invented.any()
    assert away_deg[invented].min() > 40.0
    assert inliers[invented].min() > 0.9


@pytest.mark.data
@pytest.mark.slow
def test_own_motion_does_not_turn_where_the_car_does_not(motions):
    ours, _ = motions
    yaw_deg, _ = ours.T
    assert np.abs(yaw_deg).max() < 0.05
    # It is steady, too: what is left is no noise from frame to frame.
    assert np.abs(np.diff(yaw_deg)).max() < 0.05


@pytest.mark.data
@pytest.mark.slow
def test_own_motion_goes_forward_where_the_car_does(motions):
    ours, _ = motions
    _, away_deg = ours.T
    assert np.isfinite(away_deg).all()
    assert away_deg.max() < 3.6
    assert np.median(away_deg) < 2.0
