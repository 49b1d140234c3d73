"""The same drive at 5 to 120 frames a second: the same objects, times and warnings."""

from functools import cache

import numpy as np
import pytest
from tables_of_points import Body, box, driving, ids_of, moving, results_of, street, table

CROSSING_M, CROSSING_M_S, OWN_M_S = (-12.0, 0.6, 42.0), (3.0, 0.0, 0.0), 10.0
LENGTH_M = (4.0, 1.4, 1.8)
DURATION_S, WARNED_S = 1.8, 1.4
FRAME_RATES_HZ = [5.0, 10.0, 30.0, pytest.param(60.0, marks=pytest.mark.exhaustive), 120.0]


@cache
def run(fps):
    """A car that crosses and meets us after 4 s, seen at a frame rate."""
    car = Body(box(CROSSING_M, LENGTH_M, seed=2), moving(*CROSSING_M_S))
    frames = table([street(free_way=True, seed=6), car], driving(OWN_M_S), int(DURATION_S * fps), fps, seed=1)
    return results_of(frames)


@pytest.mark.parametrize("fps", FRAME_RATES_HZ)
def test_a_crossing_car_is_warned_of_as_soon_at_any_frame_rate(fps):
    """Found by its motion over the same time, however many pictures that are; and 0.3 s of persistence."""
    assert min(event.start_s for result in run(fps) for event in result.events) < WARNED_S


@pytest.mark.parametrize("fps", FRAME_RATES_HZ)
def test_a_crossing_car_has_one_number_and_its_time_at_any_frame_rate(fps):
    late = [result for result in run(fps) if result.t_s >= WARNED_S]
    assert {tuple(ids_of(result)) for result in late} == {(1,)}
    errors = []
    for result in late:
        (row,) = [row for row in result.clusters if row.cluster_id]
        true_s = (CROSSING_M[2] - 0.5 * LENGTH_M[2]) / OWN_M_S - result.t_s
        errors.append(abs(row.times.ttc_z_s[0] / true_s - 1.0))
    # At 5 frames a second these are three, from four to seven views each.
    assert np.median(errors) < (0.06 if fps > 5.0 else 0.09)
