"""90 % intervals: the exact range over the ellipse, and how often the truth lies inside."""

import time

import numpy as np
import pytest
from moving_points import views

from ttcvid.calibration.without_file import assumed_camera, camera_from_focal, found_camera
from ttcvid.geometry.estimation.intervals import (
    NORMAL_90_SIGMAS,
    REGION_90_SIGMAS,
    collision_times_from_state,
    focal_interval_px,
    radial_and_transverse_rate,
    with_focal_interval,
)
from ttcvid.geometry.estimation.tcpa_miss_bounds import bounds_of_tcpa_and_miss
from ttcvid.geometry.paper.collision import times_from_position_velocity
from ttcvid.geometry.paper.two_view_state import state_from_direction
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import ImageSize

CHI2_90_TWO = -2.0 * np.log(0.1)


def ellipses(n, rng, least_ratio):
    turn, longer = rng.uniform(0, np.pi, n), 10 ** rng.uniform(-2, 0.5, n)
    shorter = longer * 10 ** rng.uniform(np.log10(least_ratio), 0, n)
    R = np.stack([np.stack([np.cos(turn), -np.sin(turn)], -1), np.stack([np.sin(turn), np.cos(turn)], -1)], -2)
    centre = np.column_stack([rng.normal(size=n), np.abs(rng.normal(size=n))]) * 10 ** rng.uniform(-1, 0.5, (n, 1))
    return centre, R * np.stack([longer, shorter], -1)[:, None, :] / 3.0


def ranges_by_force(centre, root):
    """Range over a border of 40000 points, as many more where it is nearest to the origin, and where it meets u = 0."""
    angle = np.linspace(0, 2 * np.pi, 40001)
    q, u = border(centre, root, angle)
    closest = angle[np.argmin(q * q + u * u)]
    before = np.flatnonzero(u[:-1] * u[1:] < 0)
    crossings = q[before] - u[before] * (q[before + 1] - q[before]) / (u[before + 1] - u[before])
    near = border(centre, root, closest + np.linspace(-0.01, 0.01, 40001))
    q, u = np.concatenate([q, near[0], crossings]), np.concatenate([u, near[1], 0 * crossings])
    q, u = q[u >= 0], u[u >= 0]
    tcpa, miss = -q / (q * q + u * u), u / (q * q + u * u)
    return tcpa.min(), tcpa.max(), miss.min(), miss.max()


def border(centre, root, angle):
    return centre[:, None] + np.sqrt(CHI2_90_TWO) * root @ np.stack([np.cos(angle), np.sin(angle)])


def test_range_over_the_ellipse_is_that_of_a_dense_border():
    centre, root = ellipses(150, np.random.default_rng(1), least_ratio=0.03)
    found = np.array(bounds_of_tcpa_and_miss(centre, root @ np.swapaxes(root, 1, 2)))
    outside = (np.linalg.solve(root, centre[..., None]) ** 2).sum(axis=(1, 2)) > CHI2_90_TWO
    assert outside.sum() > 50
    assert (np.isnan(found[0]) == ~outside).all()
    assert (np.isnan(found[3]) == ~outside).all()
    expected = np.array([ranges_by_force(c, r) for c, r in zip(centre[outside], root[outside], strict=True)]).T
    size = np.abs(expected[:2]).max(axis=0)
    np.testing.assert_allclose(found[:, outside] / size, expected / size, atol=2e-3)


def test_bounds_are_ordered_and_hold_the_value():
    centre, root = ellipses(500, np.random.default_rng(2), least_ratio=1e-6)
    tcpa_lo, tcpa_hi, miss_lo, miss_hi = bounds_of_tcpa_and_miss(centre, root @ np.swapaxes(root, 1, 2))
    q, u = centre.T
    seen = ~np.isnan(tcpa_lo)
    tcpa, miss = -q / (q * q + u * u), u / (q * q + u * u)
    slack = 1e-9 / np.hypot(q, u)[seen]
    assert ((tcpa_lo[seen] <= tcpa[seen] + slack) & (tcpa[seen] <= tcpa_hi[seen] + slack)).all()
    assert ((miss_lo[seen] <= miss[seen] + slack) & (miss[seen] <= miss_hi[seen] + slack)).all()
    assert (miss_lo[~np.isnan(miss_lo)] >= 0).all()


def test_no_uncertainty_gives_the_value_itself():
    bounds = bounds_of_tcpa_and_miss(np.array([[-0.3, 0.1], [-0.5, 0.0]]), np.zeros((2, 2, 2)))
    np.testing.assert_allclose(bounds, [[3, 2], [3, 2], [1, 0], [1, 0]], rtol=1e-12)


def test_an_interval_of_no_motion_has_no_bounds():
    tcpa_lo, tcpa_hi, miss_lo, miss_hi = bounds_of_tcpa_and_miss(np.array([[0.1, 0.1]]), 0.01 * np.eye(2)[None])
    assert np.isnan([tcpa_lo[0], tcpa_hi[0], miss_hi[0]]).all()
    assert miss_lo[0] == 0


def test_rates_are_those_of_the_velocity_and_their_covariance_that_of_draws():
    rng = np.random.default_rng(3)
    n, abc, root = 40000, np.array([0.2, -0.1, -0.4]), 0.01 * rng.normal(size=(3, 3))
    x, y, draws = (
        0.6 + 2e-3 * rng.normal(size=n),
        0.3 + 2e-3 * rng.normal(size=n),
        abc + rng.normal(size=(n, 3)) @ root.T,
    )
    rates, cov = radial_and_transverse_rate(
        np.array([0.6]), np.array([0.3]), abc[None], (root @ root.T)[None], np.array([2e-3])
    )
    drawn, _ = radial_and_transverse_rate(x, y, draws, np.zeros((n, 3, 3)), np.zeros(n))
    ray = np.array([0.6, 0.3, 1.0])
    assert rates[0, 0] == pytest.approx(ray @ abc / (ray @ ray))
    assert rates[0, 1] == pytest.approx(np.linalg.norm(np.cross(ray, abc)) / (ray @ ray))
    np.testing.assert_allclose(np.cov(drawn.T), cov[0], rtol=0.05, atol=0.02 * np.trace(cov[0]))


def coverage(times, truth):
    """How often the intervals hold the truth; a missing bound of a present time is an infinite one."""
    result = {}
    for name, value in truth._asdict().items():
        lo = np.nan_to_num(getattr(times, name.replace("_s", "_lo_s")), nan=-np.inf)
        hi = np.nan_to_num(getattr(times, name.replace("_s", "_hi_s")), nan=np.inf)
        through_infinity = (lo > hi) & ((value >= lo) | (value <= hi))
        result[name] = np.mean((lo <= value) & (value <= hi) | through_infinity)
    return result


@pytest.mark.parametrize("offset", [2.0, 6.0, 15.0])
def test_ninety_percent_intervals_of_two_views_hold_the_truth_as_often_as_they_say(offset):
    """Two views 0.5 s apart, 0.2 px at f = 720 px, a direction known to 0.3 deg."""
    rng = np.random.default_rng(4)
    n, sigma, direction_sigma, gap_s = 6000, 0.2 / 720, np.radians(0.3), 0.5
    velocity = np.tile([-0.5, 0.0, -7.0], (n, 1))
    position = 3.0 * -velocity + np.array([offset, 0.2 * offset, 0.0])
    q, p = (r / r[:, 2:] for r in views(position, velocity, [-gap_s, 0.0]))
    q[:, :2] += sigma * rng.normal(size=(n, 2))
    p[:, :2] += sigma * rng.normal(size=(n, 2))
    e = normalize(velocity)
    known = normalize(e + direction_sigma * np.einsum("nij,nj->ni", tangent_basis(e), rng.normal(size=(n, 2))))
    direction_cov = direction_sigma**2 * (np.eye(3) - known[:, :, None] * known[:, None, :])
    state, cov, _ = state_from_direction(q, p, known, gap_s, np.full(n, sigma), direction_cov)
    times = collision_times_from_state(state[:, 0], state[:, 1], state[:, 2:], cov[:, 2:, 2:], np.full(n, sigma))
    assert not np.isnan(times.ttc_z_s).any()
    covered = coverage(times, times_from_position_velocity(position, velocity))
    assert 0.87 <= covered["ttc_z_s"] <= 0.93
    # Projections of a 90 % region of two values: 96.8 %.
    assert 0.955 <= covered["tcpa_s"] <= 0.98
    assert 0.955 <= covered["miss_s"] <= 0.98


@pytest.mark.parametrize("sideways", [0.0, 0.01, 0.05, 0.5], ids=lambda s: f"sideways_{s}_hz")
@pytest.mark.parametrize("closing", [0.4, -0.4, 0.0], ids=lambda c: f"closing_{c}_hz")
def test_intervals_hold_at_constant_bearing_and_at_no_motion_too(closing, sideways):
    rng = np.random.default_rng(5)
    n, x, y = 4000, 0.3, 0.1
    ray = np.array([x, y, 1.0])
    truth = -closing * ray + sideways * np.array([1.0, -0.5, 0.0])
    root = 0.02 * np.array([[1.0, 0, 0], [0.3, 1, 0], [-0.8, 0.2, 1.5]])
    abc = truth + rng.normal(size=(n, 3)) @ root.T
    times = collision_times_from_state(
        np.full(n, x), np.full(n, y), abc, np.tile(root @ root.T, (n, 1, 1)), np.full(n, 1e-4)
    )
    expected = times_from_position_velocity(np.tile(ray, (n, 1)), np.tile(truth, (n, 1)))
    covered = coverage(times, expected)
    if truth[2] != 0.0:
        assert 0.87 <= covered["ttc_z_s"] <= 0.93
    if truth.any():
        assert 0.955 <= covered["tcpa_s"] <= 0.98
        # Where the transverse rate is next to nothing, no rate under it can be left out.
        assert 0.87 <= covered["miss_s"] <= 0.985
    else:
        assert np.isnan(times.tcpa_hi_s).mean() > 0.75


def test_interval_of_ttc_z_through_infinity_has_lo_above_hi():
    times = collision_times_from_state(
        np.zeros(1), np.zeros(1), np.array([[0.0, 0.0, -0.01]]), 1e-4 * np.eye(3)[None], np.array([1e-4])
    )
    assert times.ttc_z_s[0] == pytest.approx(100)
    assert times.ttc_z_lo_s[0] > 0 > times.ttc_z_hi_s[0]


def test_values_are_told_where_their_intervals_are_bounded():
    """What surely nears, what may recede, what surely recedes, what crosses, and what may not move."""
    abc_hz = np.array([[0, 0, -0.1], [0, 0, -0.01], [0, 0, 0.1], [0.3, 0, -0.01], [0.01, 0, -0.01]])
    times = collision_times_from_state(
        np.zeros(5), np.zeros(5), abc_hz, 1e-4 * np.eye(3)[None].repeat(5, 0), np.zeros(5)
    )
    told = times.where_bounded()
    assert np.isfinite(told.ttc_z_s).tolist() == [True, False, True, False, False]
    for name in ("tcpa", "miss"):
        assert np.isfinite(getattr(told, f"{name}_s")).tolist() == [True, False, True, True, False], name
    for name, values in vars(told).items():
        kept = np.isfinite(values) | name.endswith(("lo_s", "hi_s"))
        np.testing.assert_array_equal(values[kept], getattr(times, name)[kept])


def test_a_time_without_error_is_told():
    times = collision_times_from_state(
        np.full(1, 0.3), np.full(1, 0.2), np.array([[0.1, 0.0, -0.37]]), np.zeros((1, 3, 3)), np.zeros(1)
    )
    told = times.where_bounded()
    assert np.isfinite([told.ttc_z_s, told.tcpa_s, told.miss_s]).all()


def test_short_intervals_end_at_the_sigmas_that_they_say():
    """ttc_z at those of one normal value, tcpa and miss at those of the 90 % region of two."""
    rng = np.random.default_rng(6)
    n, abc, root = 20000, np.array([0.2, -0.1, -0.4]), 0.002 * rng.normal(size=(3, 3))
    place, exact = (np.full(n, 0.6), np.full(n, 0.3)), np.zeros(n)
    drawn = collision_times_from_state(*place, abc + rng.normal(size=(n, 3)) @ root.T, np.zeros((n, 3, 3)), exact)
    one = collision_times_from_state(np.array([0.6]), np.array([0.3]), abc[None], (root @ root.T)[None], np.zeros(1))
    for name, sigmas in (("tcpa", REGION_90_SIGMAS), ("miss", REGION_90_SIGMAS), ("ttc_z", NORMAL_90_SIGMAS)):
        length_s = getattr(one, f"{name}_hi_s")[0] - getattr(one, f"{name}_lo_s")[0]
        assert length_s / (2 * sigmas) == pytest.approx(getattr(drawn, f"{name}_s").std(), rel=0.03), name


def test_missing_states_have_no_times():
    missing = np.full((2, 3), np.nan)
    cov = np.full((2, 3, 3), np.nan)
    times = collision_times_from_state(np.zeros(2), np.zeros(2), missing, cov, np.full(2, 1e-4))
    for name, values in vars(times).items():
        assert np.isnan(values).all(), name


def test_a_thousand_points_are_quick():
    rng = np.random.default_rng(5)
    n = 1000
    abc, cov = rng.normal(size=(n, 3)) * 0.3, np.tile(1e-3 * np.eye(3), (n, 1, 1))
    x, y, sigma = rng.uniform(-0.5, 0.5, n), rng.uniform(-0.2, 0.2, n), np.full(n, 3e-4)
    durations = []
    for _ in range(10):
        start = time.process_time()
        collision_times_from_state(x, y, abc, cov, sigma)
        durations.append(time.process_time() - start)
    assert min(durations) < 0.015, "measured 2 ms; the bound leaves room for a busy machine"


def test_no_value_lies_outside_of_its_interval_by_rounding():
    """Covariances of nearly one direction: the border of the region then runs close by the value."""
    rng = np.random.default_rng(11)
    n = 20_000
    x, y = rng.uniform(-0.8, 0.8, (2, n))
    abc_hz = rng.normal(0.0, 0.4, (n, 3))
    along = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-6, -1, n)[:, None]
    cov = along[:, :, None] * along[:, None, :]
    times = collision_times_from_state(x, y, abc_hz, cov, np.full(n, 1e-9))
    for name in ("tcpa", "miss"):
        value, low, high = (getattr(times, f"{name}{end}_s") for end in ("", "_lo", "_hi"))
        assert not (value < low).any()
        assert not (value > high).any()


# --- a focal length that nobody gave ---------------------------------------------------------------------------------


def seen_with(focal_px, assumed_px):
    """Times of points that a camera of one focal length sees and one of another is taken to see; the true ones.

    Their velocities are known to a millionth.
    """
    rng = np.random.default_rng(6)
    position_m = rng.uniform([-9.0, -2.0, 8.0], [9.0, 2.0, 40.0], (200, 3))
    velocity_m_s = rng.uniform([-9.0, -0.5, -20.0], [9.0, 0.5, 3.0], (200, 3))
    part = np.array([focal_px / assumed_px, focal_px / assumed_px, 1.0])
    (x, y, _), abc_hz = (part * position_m / position_m[:, 2:]).T, part * velocity_m_s / position_m[:, 2:]
    state = x, y, abc_hz, np.broadcast_to(1e-12 * np.eye(3), (200, 3, 3)), np.full(200, 1e-6)
    return state, times_from_position_velocity(position_m, velocity_m_s)


@pytest.mark.parametrize("hfov_deg", [41.0, 55.0, 75.0, 109.0])
def test_intervals_hold_what_the_focal_length_may_be(hfov_deg):
    camera = assumed_camera(ImageSize(640, 360))
    (x, y, abc_hz, *errors), (tcpa_s, miss_s, *_) = seen_with(320.0 / np.tan(np.radians(hfov_deg) / 2.0), camera.fx_px)
    bare = collision_times_from_state(x, y, abc_hz, *errors)
    times = with_focal_interval(bare, x, y, abc_hz, camera)
    assert ((times.tcpa_lo_s <= tcpa_s) & (tcpa_s <= times.tcpa_hi_s)).all()
    # It may be largest between the focal lengths that are looked at.
    assert ((times.miss_lo_s <= miss_s) & (miss_s <= 1.003 * times.miss_hi_s)).all()
    for name in ("tcpa_s", "miss_s", "ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s"):
        np.testing.assert_array_equal(getattr(times, name), getattr(bare, name))


def test_a_focal_length_that_was_given_leaves_intervals_as_they_are_and_one_that_was_found_adds_its_error():
    size = ImageSize(640, 360)
    (x, y, abc_hz, *errors), _ = seen_with(500.0, 500.0)
    bare = collision_times_from_state(x, y, abc_hz, *errors)
    assert with_focal_interval(bare, x, y, abc_hz, camera_from_focal(500.0, size)) is bare
    found = found_camera(500.0, 10.0, size)
    assert focal_interval_px(found) == pytest.approx((500.0 * np.exp(-0.0329), 500.0 * np.exp(0.0329)), rel=1e-4)
    times, half = with_focal_interval(bare, x, y, abc_hz, found), {}
    for focal_px in focal_interval_px(found):
        part = np.array([500.0 / focal_px, 500.0 / focal_px, 1.0])
        half[focal_px] = collision_times_from_state(part[0] * x, part[0] * y, part * abc_hz, *errors).tcpa_s
    low, high = np.minimum(*half.values()), np.maximum(*half.values())
    np.testing.assert_allclose(times.tcpa_lo_s, np.minimum(low, bare.tcpa_s), atol=2e-4)
    np.testing.assert_allclose(times.tcpa_hi_s, np.maximum(high, bare.tcpa_s), atol=2e-4)


def test_an_infinite_bound_stays_infinite():
    camera, abc_hz = assumed_camera(ImageSize(640, 360)), np.array([[0.01, 0.0, -0.05]])
    x, y = np.array([0.1]), np.array([0.0])
    bare = collision_times_from_state(x, y, abc_hz, 1e-2 * np.eye(3)[None], np.array([1e-4]))
    times = with_focal_interval(bare, x, y, abc_hz, camera)
    assert np.isfinite([times.tcpa_s, times.miss_s, times.miss_lo_s]).all()
    assert np.isnan([times.tcpa_lo_s, times.tcpa_hi_s, times.miss_hi_s]).all()
