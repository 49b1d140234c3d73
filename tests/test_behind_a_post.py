"""Pictures of a car that a post hides on its way: behind it the car is still the same."""

import cv2
import numpy as np
import pytest

from ttcvid.config import BodiesConfig, EgomotionConfig, PipelineConfig, TrackingConfig
from ttcvid.model import Frame, Platform
from ttcvid.pipeline import analyze_frames
from ttcvid.simulate import camera_of
from ttcvid.simulate.render import render_frames
from ttcvid.simulate.scene import Scene

BEFORE, BEHIND = slice(6, 12), slice(42, 50)
POST_M = 1.5


def scene():
    """A car crosses 29 m ahead, 20 pictures a second; for five of them none of it is seen."""
    film = {"fps": 20, "n_frames": 50}
    speed_and_colour = {"speed_m_s": 8, "colour_rgb": [180, 40, 40]}
    house = {"kind": "house", "size_m": [12, 9, 7.5]}
    return Scene.model_validate(
        {
            "name": "post",
            "description": "a car crosses behind a post",
            "seed": 3,
            "camera": {"image_size": [640, 360], "hfov_deg": 80, "height_m": 1.4, "pitch_deg": 2, **film},
            "own_motion": {"speed_m_s": 2},
            "ground": {"kind": "street", "road_width_m": 8, "road_offset_m": 2},
            "bodies": [
                {"name": "car", "kind": "car", "at_m": [29, -10.4, 0], "heading_deg": 90, **speed_and_colour},
                {"name": "post", "kind": "box", "at_m": [9, 0, 0], "size_m": [0.4, POST_M, 3.5]},
                {"name": "left house", "at_m": [45, 15, 0], **house},
                {"name": "right house", "at_m": [45, -14, 0], **house},
                {"name": "end of the street", "kind": "house", "at_m": [80, 2, 0], "size_m": [10, 90, 11]},
            ],
        }
    )


def numbers_on_car(results, cars):
    """Number of the object with most of the tracks on the car, in each frame with any."""
    numbers = []
    for result, is_car in zip(results, cars, strict=True):
        column, row = np.rint(result.tracks.xy_px).astype(int).T
        own = result.tracks.cluster_id[is_car[row, column] & (result.tracks.cluster_id > 0)]
        numbers += [int(np.bincount(own).argmax())] if len(own) else []
    return numbers


@pytest.mark.slow
def test_a_car_that_comes_out_from_behind_a_post_keeps_its_number():
    pictures = list(render_frames(scene()))
    cars = [(picture.labels > 0) & (picture.labels < np.iinfo(np.uint16).max) for picture in pictures]
    assert [picture.frame for picture, car in zip(pictures, cars, strict=True) if not car.any()] == list(range(24, 29))
    frames = [Frame(p.frame, p.t_s, grey=cv2.cvtColor(p.bgr, cv2.COLOR_BGR2GRAY)) for p in pictures]
    # The car is some 20 px high: its tracks stand close, and few make it an object.
    config = PipelineConfig(
        tracking=TrackingConfig(min_distance_px=5.0),
        egomotion=EgomotionConfig(platform=Platform.vehicle),
        bodies=BodiesConfig(min_tracks=4),
    )
    results = [result for _, result in analyze_frames(frames, camera_of(scene()), config)]
    before = numbers_on_car(results[BEFORE], cars[BEFORE])
    behind = numbers_on_car(results[BEHIND], cars[BEHIND])
    assert len(before) == 6
    assert len(behind) >= 6
    assert set(before) == set(behind) == {1}
