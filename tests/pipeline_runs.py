"""All stages together on exact tracks of sample scenes: runs, and what tests ask of their results."""

from functools import cache
from pathlib import Path

import numpy as np
from moving_clips import HEIGHT, WIDTH

from ttcvid.config import EgomotionConfig, PipelineConfig
from ttcvid.model import Camera, Frame, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames
from ttcvid.simulate import TrackOptions, camera_of, load_scene, simulate_tracks

SCENES = Path(__file__).resolve().parent.parent / "sample_configs" / "scenes"
VEHICLE = PipelineConfig(egomotion=EgomotionConfig(platform=Platform.vehicle))
PICTURE_CAMERA = Camera(180.0, 180.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, ImageSize(WIDTH, HEIGHT))


@cache
def scene(name, n_frames=12):
    whole = load_scene(SCENES / f"{name}.yaml")
    return whole.model_copy(update={"camera": whole.camera.model_copy(update={"n_frames": n_frames})})


@cache
def table(name, n_frames=12, sigma_px=0.1, n_tracks=180, min_per_object=8):
    """Frames of point tracks of a sample scene, and its camera."""
    options = TrackOptions(n_tracks, min_per_object=min_per_object, sigma_px=sigma_px)
    tracks = simulate_tracks(scene(name, n_frames), options)
    frames = []
    for index in range(n_frames):
        here = tracks.frame == index
        points = PointSet(tracks.track_id[here], tracks.xy_px[here])
        frames.append(Frame(index, float(tracks.t_s[here][0]), points=points))
    return tuple(frames), camera_of(scene(name, n_frames))


def results_of(frames, camera, config=VEHICLE, **options):
    return [result for _, result in analyze_frames(frames, camera, config, **options)]


@cache
def plain_run(name):
    return results_of(*table(name))


def statuses(results):
    return [str(result.status) for result in results]


def scene_row(result):
    return next((row for row in result.clusters if row.cluster_id == 0), None)


def assert_same(one, other, rtol=0.0, atol=0.0):
    """Two results with the same numbers, arrays and all."""
    for a, b in zip(one, other, strict=True):
        assert a.status == b.status
        assert (a.rotation_rad is None) == (b.rotation_rad is None)
        if a.rotation_rad is not None:
            np.testing.assert_allclose(a.rotation_rad, b.rotation_rad, rtol, atol)
        np.testing.assert_array_equal(a.tracks.track_id, b.tracks.track_id)
        np.testing.assert_array_equal(a.tracks.cluster_id, b.tracks.cluster_id)
        np.testing.assert_array_equal(a.tracks.status, b.tracks.status)
        np.testing.assert_allclose(a.tracks.times.ttc_z_s, b.tracks.times.ttc_z_s, rtol, atol)
        assert [row.cluster_id for row in a.clusters] == [row.cluster_id for row in b.clusters]


def has_no_numbers(result):
    return (
        len(result.tracks.track_id) == 0
        and result.clusters == ()
        and result.rotation_rad is None
        and result.rotation_sigma_rad is None
        and result.min_ttc_z_s is None
    )
