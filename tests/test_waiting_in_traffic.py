"""A car that waits, and traffic that crosses before it: few tracks, most of them on what moves."""

import numpy as np
import pytest
from tables_of_points import STILL, Body, box, moving, results_of, street, table


def plane(n, seed):
    """Static points of the road and of houses across it."""
    rng = np.random.default_rng(seed)
    x_m, z_m = rng.uniform(-8.0, 8.0, n // 2), 1.5 / rng.uniform(0.1, 0.4, n // 2)
    road = np.column_stack([x_m, np.full(n // 2, 1.5), z_m])
    return np.concatenate([road, street(n - n // 2, (20.0, 60.0), 0.0, seed).points_m])


@pytest.mark.parametrize("seed", range(2))
def test_a_bus_of_few_tracks_that_fills_half_of_the_picture_is_an_object_and_we_do_not_drift(seed):
    bus = Body(box((-8.0, -0.3, 7.0), (11.0, 2.6, 0.5), n=70, seed=seed), moving(5.0, 0.0, 0.0))
    walker = Body(box((3.0, 0.5, 6.0), (0.5, 1.7, 0.3), n=14, seed=seed), moving(-1.2, 0.0, 0.0))
    results = results_of(table([Body(plane(60, seed)), bus, walker], STILL, n_frames=30, seed=seed))
    of_bus = []
    for result in results[8:26]:
        assert next(row for row in result.clusters if row.cluster_id == 0).direction is None
        is_bus = (result.tracks.track_id >= 60) & (result.tracks.track_id < 130)
        of_bus.append(np.mean(result.tracks.cluster_id[is_bus] > 0))
    assert np.mean(of_bus) > 0.8
