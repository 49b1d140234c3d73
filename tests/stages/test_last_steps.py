"""Movers from frame to frame: their paths keep up with them."""

import numpy as np
import pytest
from watched_things import (
    N_FRAMES,
    N_VIEWS,
    SCENE,
    box,
    braking,
    coming_near,
    converged,
    median_redchi,
    rays_of,
    seen,
    true_path,
    turning,
)

from ttcvid.stages.segmentation.bodies import carried_forward, refined_movers, stepped_movers

ONE_STEP = np.array([1])


def followed(motion, rng, step):
    """The misfits of a thing that is followed from its true path on, frame by frame."""
    rays, paths, rate_hz, redchi_of = rays_of(motion, box(rng), rng), true_path(motion, N_VIEWS - 1), None, []
    rate_hz = np.array([np.median(converged(seen(rays, N_VIEWS - 1), paths).rate_hz)])
    for frame in range(N_VIEWS, N_FRAMES):
        points = seen(rays, frame)
        carried = carried_forward(paths, np.eye(3), points.since_s)
        paths, rate_hz = step(carried, SCENE, points, ONE_STEP, rate_hz)
        redchi_of.append(median_redchi(points, paths))
    return redchi_of


@pytest.mark.parametrize(("motion", "most"), [(braking, 1.3), (coming_near, 1.3), (turning, 3.0)])
def test_a_path_keeps_up_with_what_brakes_comes_near_or_turns(motion, most):
    redchi_of = followed(motion, np.random.default_rng(1), stepped_movers)
    assert max(redchi_of) < most


@pytest.mark.parametrize("motion", [braking, coming_near, turning])
def test_points_and_views_in_turn_would_stay_behind(motion):
    redchi_of = followed(motion, np.random.default_rng(1), lambda *of: refined_movers(*of[:4]))
    assert max(redchi_of) > 20.0
