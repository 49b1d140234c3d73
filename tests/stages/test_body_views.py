"""The noise of a track with the error of the camera."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX, history_of

from ttcvid.stages.segmentation.body_views import body_views


@pytest.mark.parametrize(("origin", "least_px"), [("focal_px", 0.1), ("assumed", 640 / 1920), ("found", 640 / 1920)])
def test_positions_have_the_error_of_the_lens_at_least(origin, least_px):
    history = history_of(np.array([[1.0, 0.0, 20.0], [-2.0, 1.0, 30.0]]), np.zeros(3), 0.1 * np.arange(5))
    camera = replace(CAMERA, origin=origin, focal_sigma_px=10.0 if origin == "found" else None)
    history = replace(history, sigma_px=np.array([0.01, 0.5]), camera=camera, common_error_px=0.25)
    views = body_views(history, np.ones(2, dtype=bool), 32.0, can_translate=True)
    np.testing.assert_allclose(views.sigma_norm * FOCAL_PX, [least_px, 0.5], rtol=1e-6)
    # Tracks drift together by what an unknown lens does to a picture that moves.
    assert views.common_px == pytest.approx(0.25 if origin == "focal_px" else np.hypot(0.25, 2.0 * least_px))
    still = body_views(history, np.ones(2, dtype=bool), 32.0, can_translate=False)
    assert still.common_px == 0.25
