"""Objects whose times jump about by more than their own errors have none."""

import numpy as np
import pytest

from ttcvid.model import ClusterRow, CollisionTimes, Floats, MotionState, Status
from ttcvid.stages.objects.consistency import Rates, contradicts_itself, steady_rows

STEP_S = 0.05


def rates_of(depth_m: Floats, relative_sigma: float, seed: int) -> Floats:
    """-Vz/Z of a thing at these depths, one a frame, with errors of this part, as the memory has them."""
    rng = np.random.default_rng(seed)
    t_s = STEP_S * np.arange(len(depth_m))
    rate = -np.gradient(depth_m, STEP_S) / depth_m
    sigma = relative_sigma * np.abs(rate) + 0.01
    return np.column_stack((t_s, rate + sigma * rng.normal(size=len(rate)), sigma))


def begun(first_m: float, braking_m_s2: float, n: int = 30) -> Floats:
    """Depths of what goes as fast as we do, and brakes from the middle on."""
    since_s = np.maximum(STEP_S * (np.arange(n) - n // 2), 0.0)
    return first_m - 0.5 * braking_m_s2 * since_s**2


def straight(first_m: float, speed_m_s: float, n: int = 30) -> Floats:
    return first_m - speed_m_s * STEP_S * np.arange(n)


@pytest.mark.parametrize(
    "depth_m",
    [
        straight(60.0, 10.0),
        straight(20.0, 11.0),
        # 0.3 s before contact.
        straight(17.5, 10.0),
        straight(30.0, -8.0),
        # It brakes with 5 m/s^2 before us.
        20.0 - 2.5 * (STEP_S * np.arange(30)) ** 2,
    ],
    ids=["far", "near", "contact", "receding", "braking"],
)
def test_true_rates_contradict_one_another_in_one_of_a_thousand(depth_m: Floats) -> None:
    found = [contradicts_itself(rates_of(depth_m, 0.05, seed)) for seed in range(2000)]
    # Five standard deviations above one in a thousand.
    assert np.mean(found) <= 0.001 + 5.0 * np.sqrt(0.001 / 2000)


@pytest.mark.parametrize("first_m", [12.0, 8.0, 6.0])
def test_who_begins_to_brake_near_us_contradicts_itself_in_one_of_a_hundred(first_m: float) -> None:
    found = [contradicts_itself(rates_of(begun(first_m, 5.0), 0.05, seed)) for seed in range(1000)]
    assert np.mean(found) <= 0.01 + 5.0 * np.sqrt(0.01 / 1000)


def test_another_thing_in_each_frame_contradicts_itself() -> None:
    far, near = rates_of(straight(60.0, 10.0), 0.05, 1), rates_of(straight(25.0, 10.0), 0.05, 2)
    mixed = np.where((np.arange(30) % 3 == 0)[:, None], near, far)
    assert contradicts_itself(mixed)
    assert not contradicts_itself(far)
    assert not contradicts_itself(near)


def test_a_few_rates_are_not_tested() -> None:
    rates = rates_of(straight(60.0, 10.0), 0.05, 1)[:4]
    rates[:, 1] = [0.1, 0.9, 0.1, 0.9]
    assert not contradicts_itself(rates)


def test_a_rate_that_would_have_ended_by_now_says_nothing() -> None:
    rates = rates_of(straight(60.0, 10.0), 0.02, 1)
    # Time left 0.2 s, 1.4 s ago: an outlier of the time when the object was found.
    rates[0, 1:] = 5.0, 0.1
    assert not contradicts_itself(rates)


def row(cluster_id: int, rate_hz: float, sigma_hz: float = 0.02) -> ClusterRow:
    return ClusterRow(
        cluster_id,
        1,
        9,
        (100.0, 100.0, 150.0, 140.0),
        Status.ok,
        Status.ok,
        "whole-tracks",
        MotionState.approaching,
        direction=np.array([0.0, 0.0, -1.0]),
        ref_px=(125.0, 120.0),
        state_abc_hz=np.array([0.0, 0.0, -rate_hz]),
        state_cov=sigma_hz**2 * np.eye(3),
        times=CollisionTimes(*np.full((9, 1), 1.0 / rate_hz)),
        urgency_rank=cluster_id,
    )


def test_the_row_of_what_contradicts_itself_says_so_and_the_others_move_up() -> None:
    rates, rows = Rates(), ()
    for step in range(20):
        rate_hz = 0.9 if step % 2 else 0.2
        rows, rates = steady_rows(rates, step * STEP_S, (row(1, rate_hz), row(2, 0.2)))
    jumpy, steady = rows
    assert jumpy.status == Status.not_rigid
    assert jumpy.motion_state == MotionState.unknown
    assert jumpy.state_abc_hz is None
    assert jumpy.ref_px is None
    assert np.isnan(jumpy.times.ttc_z_s[0])
    assert jumpy.urgency_rank is None
    # Where to it seems to move is still known.
    assert jumpy.direction is not None
    assert steady.times.ttc_z_s[0] == pytest.approx(5.0)
    assert steady.urgency_rank == 1


def test_errors_over_views_in_common_contradict_one_another_no_more_often_at_a_high_frame_rate() -> None:
    step_s, n_views, n_jumpy = 1.0 / 120.0, 20, 0
    rng = np.random.default_rng(1)
    lag = np.arange(n_views) - 0.5 * (n_views - 1)
    for _ in range(10):
        # As a slope through the last views errs.
        errors = np.convolve(rng.normal(size=400), lag / np.linalg.norm(lag), mode="valid")
        rates = Rates()
        for step, error in enumerate(errors.tolist()):
            (one,), rates = steady_rows(rates, step * step_s, (row(1, 0.2 + 0.02 * error),))
            n_jumpy += one.status == Status.not_rigid
    assert n_jumpy <= 0.001 * 10 * len(errors)


def test_what_has_settled_is_believed_again_and_what_is_gone_is_forgotten() -> None:
    rates, rows = Rates(), ()
    for step in range(60):
        rate_hz = 0.9 if step % 2 and step < 20 else 0.2
        rows, rates = steady_rows(rates, step * STEP_S, (row(1, rate_hz),))
    assert rows[0].status == Status.ok
    _, rates = steady_rows(rates, 60 * STEP_S, ())
    assert set(rates.of_cluster) == {1}
    _, rates = steady_rows(rates, 60 * STEP_S + 2.0, ())
    assert not rates.of_cluster
