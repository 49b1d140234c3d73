"""Errors over distance: closed forms against the Cramer-Rao bound, against Monte-Carlo, and against known figures."""

from dataclasses import astuple

import numpy as np
import pytest

from ttcvid.config import SensitivityConfig
from ttcvid.studies.sensitivity import bounds, formulas, trials
from ttcvid.studies.sensitivity.case import Case, Errors
from ttcvid.studies.sensitivity.study import (
    Method,
    base_case,
    is_small,
    methods,
    reach_m,
    reaches_m,
    sensitivity,
    summary,
)

PAPER = base_case(SensitivityConfig())
ALL = methods([5, 10, 20])
CASES = [
    PAPER.with_(distance_m=distance, angle_rad=np.radians(angle), height_m=height)
    for distance, angle, height in [(6.0, 45.0, 1.0), (15.0, 10.0, 2.0), (40.0, 45.0, 1.0), (90.0, 70.0, 0.5)]
]


def values(errors: Errors) -> list[float]:
    return [errors.direction_rad, errors.ttc_z, errors.tcpa]


def test_the_paper_is_the_default_case():
    wanted = Case(50.0, 1.0, 50 / 3.6, np.radians(45.0), 8 / 4.65e-3, 0.2, 1 / 12, 0.15)
    np.testing.assert_allclose(astuple(PAPER), astuple(wanted), rtol=1e-12)


@pytest.mark.parametrize("method", ALL, ids=lambda method: method.label)
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.distance_m:g} m")
def test_closed_form_is_the_bound(method: Method, case: Case):
    np.testing.assert_allclose(values(method.formula(case)), values(method.bound(case)), rtol=1e-9)


@pytest.mark.parametrize("method", ALL, ids=lambda method: method.label)
def test_monte_carlo_of_the_real_functions_agrees_with_closed_form_and_bound(method: Method):
    n_checked = 0
    for k, case in enumerate(CASES):
        formula = method.formula(case)
        found = trials.errors_of(case, method.trials(case, 20000, np.random.default_rng([3, k])))
        small = is_small(formula)
        for holds, tried, closed, limit in zip(
            small.values(), values(found), values(formula), values(method.bound(case)), strict=True
        ):
            if holds:
                assert tried == pytest.approx(closed, rel=0.05)
                assert tried == pytest.approx(limit, rel=0.05)
                n_checked += 1
    assert n_checked >= 2


def test_stereo_depth_error_grows_with_the_square_of_distance():
    case = PAPER.with_(distance_m=20.0)
    rng = np.random.default_rng(8)
    disparity = case.baseline_m / 20.0 + case.sigma_norm * (rng.standard_normal(40000) - rng.standard_normal(40000))
    tried = float(np.std(case.baseline_m / disparity))
    assert tried == pytest.approx(formulas.stereo_depth_sigma_m(case), rel=0.03)
    twice = formulas.stereo_depth_sigma_m(PAPER.with_(distance_m=40.0))
    assert twice == pytest.approx(4 * formulas.stereo_depth_sigma_m(case))


def test_stereo_time_error_is_that_of_two_depths():
    case = PAPER.with_(distance_m=30.0, angle_rad=0.0)
    depths = 30.0 + np.array([case.step_s, 0.0]) * case.speed_m_s
    sigma_m = depths**2 * np.sqrt(2) * case.sigma_norm / case.baseline_m
    # T = gap Z1 / (Z0 - Z1): by Z0 and by Z1.
    fall = depths[0] - depths[1]
    by_log = np.array([-1.0 / fall, 1.0 / depths[1] + 1.0 / fall])
    assert formulas.stereo(case).ttc_z == pytest.approx(float(np.hypot(*(by_log * sigma_m))), rel=1e-9)


def variance_of_c(case, n_frames):
    """The variance of c = Vz / Z in 1/s^2 by the formula of moments that `formulas.general` names."""
    x, y, a, b, c = case.state
    t = case.times_s(n_frames)
    tau = t / (1.0 + c * t)
    m2, m3, m4 = (((tau - tau.mean()) ** k).sum() for k in (2, 3, 4))
    flow2 = (a - x * c) ** 2 + (b - y * c) ** 2
    return case.sigma_norm**2 / (flow2 * (m4 - m3 * m3 / m2 - m2 * m2 / n_frames))


def test_formula_of_moments_is_the_variance_of_c():
    for n_frames in (3, 5, 20):
        c = PAPER.state[4]
        relative = formulas.general(PAPER, n_frames).ttc_z
        assert np.sqrt(variance_of_c(PAPER, n_frames)) / abs(c) == pytest.approx(relative, rel=1e-9)


def test_for_short_windows_the_variance_of_c_is_that_of_a_parabola():
    far, n = PAPER.with_(distance_m=5000.0), 10
    flow = PAPER.speed_m_s * np.sin(PAPER.angle_rad) / 5000.0
    short = 180 * far.sigma_norm**2 / (flow**2 * far.step_s**4 * n * (n**2 - 1) * (n**2 - 4))
    assert variance_of_c(far, n) == pytest.approx(short, rel=0.01)


def test_known_figures_of_the_general_case_at_100_m():
    """Cramer-Rao bounds that the design names: 224 %, 9 % and 1.8 % with 3, 10 and 20 frames at f = 1720 px."""
    case = PAPER.with_(distance_m=100.0)
    errors = [bounds.bound(case, n, is_planar=False).ttc_z for n in (3, 10, 20)]
    np.testing.assert_allclose(errors, [2.24, 0.09, 0.018], rtol=0.04)


def test_reach_is_where_the_error_passes_the_limit():
    for method in ALL:
        reach = reach_m(PAPER, method, 0.1)
        assert method.formula(PAPER.with_(distance_m=reach)).ttc_z == pytest.approx(0.1, rel=0.03)


def test_more_pictures_a_longer_focal_length_and_less_noise_reach_farther():
    by_frames = [reach_m(PAPER, method, 0.1) for method in methods([5, 10, 20])[2:5]]
    assert by_frames == sorted(by_frames)
    stereo = ALL[-1]
    assert reach_m(PAPER.with_(focal_px=2 * PAPER.focal_px), stereo, 0.1) > 1.2 * reach_m(PAPER, stereo, 0.1)
    assert reach_m(PAPER.with_(sigma_px=0.1), stereo, 0.1) > 1.2 * reach_m(PAPER, stereo, 0.1)


def test_no_flow_means_no_answer():
    still = PAPER.with_(height_m=0.0, angle_rad=0.0)
    for n_frames in (3, 20):
        assert formulas.general(still, n_frames).ttc_z == np.inf
        assert bounds.bound(still, n_frames, is_planar=False).ttc_z == np.inf
    assert formulas.planar_two_frame(PAPER.with_(height_m=0.0)).ttc_z == np.inf


def test_every_quantity_can_be_varied():
    for over in ("distance", "angle", "focal", "noise", "rate", "height"):
        config = SensitivityConfig(over=over, steps=2, trials=100, frames="5", distance_m=20.0)
        points = list(sensitivity(config))
        assert len(points) == 2 * 4
        first, last = points[0], points[4]
        assert first.method.name == last.method.name == "planar_two_frame"
        assert first.formula.ttc_z != last.formula.ttc_z


def test_summary_names_every_method_and_its_distance():
    config = SensitivityConfig(frames="5,20")
    sentence = summary(config, reaches_m(config))
    assert sentence.startswith("time to collision within 10 %: planar, 2 frames up to ")
    for words in ("general, 3 frames", "whole track, 5 frames", "whole track, 20 frames", "stereo pair up to 6.6"):
        assert words in sentence
