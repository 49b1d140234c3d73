"""How close the estimate from whole tracks comes to what noise allows: against the Cramer-Rao bound, and its intervals.

python benchmarks/estimator.py [--tracks 4000] [--seed 0] [--write-docs] [--check]

Synthetic tracks with known rotation: points at random places, in random relative motion with k frames to go, seen over
a window of frames with Gaussian noise. Three cases: general motion (nothing known of its direction), planar motion (a
horizon known to 0.1 deg), and a known direction (a point of a cluster). The bound is that of eta = 1 / ttc_z, from
derivatives of projected pixels taken numerically in position and velocity: no code of the estimator is in it.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from report import Bar, Report

from ttcvid.geometry.estimation.intervals import collision_times_from_state
from ttcvid.geometry.estimation.track_on_trajectory import fit_rates_on_paths, straight_path
from ttcvid.geometry.estimation.track_state import MotionPlane, fit_whole_tracks
from ttcvid.model import CollisionTimes, Floats

FOCAL_PX, DT_S = 720.0, 0.1
SIGMAS_PX, FRAMES_TO_GO, WINDOWS = (0.2, 0.5), (10, 20, 40, 60, 90, 120), (10, 20)
PLANE_SIGMA_RAD = np.radians(0.1)
PLANE = MotionPlane(np.array([0.0, -1.0, 0.0]), PLANE_SIGMA_RAD**2 * np.diag([1.0, 0.0, 1.0]))
CASES = ("general", "planar", "known direction")
RMSE_BAR, COVER_LOW_BAR, COVER_HIGH_BAR, COVER_LOW_BAR = (
    Bar(1.1),
    Bar(0.87, at_least=True),
    Bar(0.93),
    Bar(0.87, True),
)
BOUND_LIMIT = 0.3
"""Relative bound of eta above which no estimate is worth much; the bars hold below it."""


@dataclass(frozen=True)
class Tracks:
    """N points at P / Z and V / Z (``place, rate (N, 3)``) at time 0, and their noisy views ``xy (L, N, 2)``."""

    place: Floats
    rate: Floats
    t_s: Floats
    xy: Floats
    sigma_norm: Floats


@dataclass(frozen=True)
class Estimates:
    """Of N tracks: eta = 1 / ttc_z with its standard deviation, in 1/s, and the times with their intervals."""

    eta_hz: Floats
    times: CollisionTimes


def draw(case: str, k_frames: int, n_frames: int, sigma_px: float, n: int, rng: np.random.Generator) -> Tracks:
    """Points all over a picture of 60 by 30 deg, 20 to 300 px from their epipoles, ``k_frames`` from depth zero."""
    place = np.column_stack([rng.uniform(-0.55, 0.55, n), rng.uniform(-0.27, 0.27, n), np.ones(n)])
    eta_hz = 1.0 / (k_frames * DT_S)
    rho, angle = rng.uniform(20.0, 300.0, n) / FOCAL_PX, rng.uniform(0.0, 2.0 * np.pi, n)
    epipole = place[:, :2] + rho[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if case == "planar":
        # The epipole lies on the horizon, but for its error; points too near the horizon have no planar answer.
        place[:, 1] = np.where(place[:, 1] < 0, -1, 1) * np.maximum(np.abs(place[:, 1]), 20.0 / FOCAL_PX)
        epipole = np.column_stack([place[:, 0] + rho * np.cos(angle), PLANE_SIGMA_RAD * rng.normal(size=n)])
    rate = -eta_hz * np.column_stack([epipole, np.ones(n)])
    t_s = -DT_S * np.arange(n_frames)[::-1]
    noise = sigma_px / FOCAL_PX * rng.normal(size=(n_frames, n, 2))
    return Tracks(place, rate, t_s, _project(place, rate, t_s) + noise, np.full(n, sigma_px / FOCAL_PX))


def estimate(case: str, tracks: Tracks) -> Estimates:
    """What the estimator makes of the views."""
    n = len(tracks.place)
    if case == "known direction":
        direction = tracks.rate / np.linalg.norm(tracks.rate, axis=1, keepdims=True)
        paths = np.stack([straight_path(e, tracks.t_s) for e in direction])
        found = fit_rates_on_paths(tracks.xy, tracks.t_s, tracks.sigma_norm, paths, np.arange(n))
        xy, rate = found.state[:, :2], found.rate_hz[:, None] * direction
        cov = found.cov[:, 2, 2, None, None] * np.einsum("ni,nj->nij", direction, direction)
    else:
        plane = PLANE if case == "planar" else None
        states = fit_whole_tracks(tracks.xy, tracks.t_s, tracks.sigma_norm, plane=plane)
        xy, rate, cov = states.state[:, :2], states.state[:, 2:], states.cov[:, 2:, 2:]
    times = collision_times_from_state(xy[:, 0], xy[:, 1], rate, cov, tracks.sigma_norm)
    return Estimates(-rate[:, 2], times)


def bound_of_eta(case: str, tracks: Tracks) -> Floats:
    """Cramer-Rao bound of eta in 1/s, (N,): square root of its element of the inverse Fisher information.

    Unknowns: the place (2) and the rate (3), or with a known direction its length (1). The horizon's error counts as
    prior information.
    """
    place, rate = tracks.place, tracks.rate
    n, speed = len(place), np.linalg.norm(rate, axis=1)
    axes = [np.eye(3)[0], np.eye(3)[1]]
    moves = [(np.broadcast_to(axis, (n, 3)), np.zeros((n, 3))) for axis in axes]
    if case == "known direction":
        moves.append((np.zeros((n, 3)), rate / speed[:, None]))
    else:
        moves += [(np.zeros((n, 3)), np.broadcast_to(axis, (n, 3))) for axis in np.eye(3)]
    step = 1e-5
    columns = [
        (
            _project(place + step * dp, rate + step * dr, tracks.t_s)
            - _project(place - step * dp, rate - step * dr, tracks.t_s)
        )
        / (2.0 * step)
        for dp, dr in moves
    ]
    jacobian = np.stack(columns, axis=-1).transpose(1, 0, 2, 3).reshape(n, -1, len(moves))
    jacobian = jacobian / tracks.sigma_norm[:, None, None]
    fisher = np.einsum("nki,nkj->nij", jacobian, jacobian)
    if case == "planar":
        prior = np.zeros((5, 5))
        prior[2:, 2:] = np.outer(PLANE.normal, PLANE.normal)
        fisher = fisher + prior / (PLANE_SIGMA_RAD * speed[:, None, None]) ** 2
    bound = np.sqrt(np.linalg.inv(fisher)[:, -1, -1])
    return bound * np.abs(rate[:, 2]) / speed if case == "known direction" else bound


def _project(place: Floats, rate: Floats, t_s: Floats) -> Floats:
    point = place + t_s[:, None, None] * rate
    return point[..., :2] / point[..., 2:]


def coverage(tracks: Tracks, found: Estimates, chosen: Floats) -> tuple[float, float, float]:
    """Part of the chosen tracks whose 90 % interval of ttc_z, tcpa and miss holds the truth (NaN: infinite)."""
    place, rate, times = tracks.place[chosen], tracks.rate[chosen], found.times.take(chosen)
    speed2 = np.sum(rate**2, axis=1)
    tcpa_s, miss_s = -np.sum(place * rate, axis=1) / speed2, np.linalg.norm(np.cross(place, rate), axis=1) / speed2
    eta_hz = -rate[:, 2]
    in_z = (eta_hz <= 1.0 / times.ttc_z_lo_s) & (eta_hz >= 1.0 / times.ttc_z_hi_s)
    in_tcpa = ~(tcpa_s < times.tcpa_lo_s) & ~(tcpa_s > times.tcpa_hi_s)
    in_miss = ~(miss_s < times.miss_lo_s) & ~(miss_s > times.miss_hi_s)
    return float(np.mean(in_z)), float(np.mean(in_tcpa)), float(np.mean(in_miss))


def measure_case(report: Report, case: str, n: int, seed: int) -> None:
    """One table a case: every k, window and noise, and the worst of all against the bars."""
    report.heading(f"{case.capitalize()}{' motion' if ' ' not in case else ''}")
    rows, ratios, covers = [], [], []
    for number, (k, n_frames, sigma_px) in enumerate(
        (k, n_frames, sigma_px) for k in FRAMES_TO_GO for n_frames in WINDOWS for sigma_px in SIGMAS_PX
    ):
        tracks = draw(case, k, n_frames, sigma_px, n, np.random.default_rng([seed, CASES.index(case), number]))
        found, bound = estimate(case, tracks), bound_of_eta(case, tracks)
        eta_hz = -tracks.rate[:, 2]
        chosen = bound < BOUND_LIMIT * eta_hz
        if np.count_nonzero(chosen) < 0.05 * n:
            rows.append([str(k), str(n_frames), f"{sigma_px:g}", f"{100 * np.mean(chosen):.0f} %"] + ["-"] * 5)
            continue
        ratio = float(np.sqrt(np.mean(((found.eta_hz - eta_hz)[chosen] / bound[chosen]) ** 2)))
        cover = coverage(tracks, found, chosen)
        rows.append(
            [str(k), str(n_frames), f"{sigma_px:g}", f"{100 * np.mean(chosen):.0f} %"]
            + [f"{100 * np.median(bound[chosen] / eta_hz[chosen]):.2g} %", f"{ratio:.3f}"]
            + [f"{100 * part:.1f} %" for part in cover]
        )
        ratios.append(ratio)
        covers.append(cover)
    report.table(
        ["k", "frames", "sigma px", "judged", "bound", "rmse / bound", "ttc_z hold", "tcpa hold", "miss hold"],
        rows,
    )
    z, tcpa, miss = np.array(covers).T
    report.figure(f"{case}: rmse of eta over the bound, worst row", max(ratios), "", RMSE_BAR)
    report.figure(f"{case}: intervals of ttc_z that hold, least", float(z.min()), "", COVER_LOW_BAR)
    report.figure(f"{case}: intervals of ttc_z that hold, most", float(z.max()), "", COVER_HIGH_BAR)
    report.figure(f"{case}: intervals of tcpa that hold, least", float(tcpa.min()), "", COVER_LOW_BAR)
    report.figure(f"{case}: intervals of miss that hold, least", float(miss.min()), "", COVER_LOW_BAR)


def measure_known_bounds(report: Report) -> None:
    """The bound itself at the sizes of docs/how_it_works.md: 100 m, 50 km/h, 12 Hz, f = 1720 px, 0.2 px."""
    report.heading("What more frames are worth")
    report.say("The bound alone: a point 100 m ahead and 50 m off our path, 50 km/h, 12 Hz, f = 1720 px, 0.2 px.")
    rows = []
    for n_frames in (3, 5, 10, 20):
        place, rate = np.array([[0.5, 0.0, 1.0]]), np.array([[0.0, 0.0, -50.0 / 3.6 / 100.0]])
        tracks = Tracks(place, rate, -np.arange(n_frames) / 12.0, np.empty(0), np.array([0.2 / 1720.0]))
        parts = [100.0 * float(bound_of_eta(case, tracks)[0] / -rate[0, 2]) for case in ("general", "known direction")]
        rows.append([str(n_frames), *(f"{part:.2g} %" for part in parts)])
    report.table(["frames", "direction unknown", "direction known"], rows)


def measure_speed(report: Report, rng: np.random.Generator) -> None:
    """Processor time of one thread."""
    report.heading("Speed")
    for case in ("general", "known direction"):
        tracks = draw(case, 60, 20, 0.2, 1000, rng)
        if case == "known direction":
            # All on one path, as the tracks of a cluster are.
            rate = np.broadcast_to(tracks.rate[0], (1000, 3))
            noise = tracks.sigma_norm[:, None] * rng.normal(size=tracks.xy.shape)
            tracks = replace(tracks, rate=rate, xy=_project(tracks.place, rate, tracks.t_s) + noise)
        estimate(case, tracks)
        direction = tracks.rate[0] / np.linalg.norm(tracks.rate[0])
        path, number = straight_path(direction, tracks.t_s)[None], np.zeros(1000, np.int64)
        start_s, repeats = time.thread_time(), 20
        for _ in range(repeats):
            if case == "general":
                fit_whole_tracks(tracks.xy, tracks.t_s, tracks.sigma_norm)
            else:
                fit_rates_on_paths(tracks.xy, tracks.t_s, tracks.sigma_norm, path, number)
        spent_ms = 1000.0 * (time.thread_time() - start_s) / repeats
        report.figure(f"{case}: 1000 tracks of 20 frames", spent_ms, "ms")


def measure(report: Report, n: int = 4000, seed: int = 0) -> None:
    """All cases."""
    report.say(
        "Judged are the tracks whose bound is below 30 % of eta. `k`: frames until depth zero; `frames`: views of a "
        "track; `bound`: the median of theirs. An interval should hold the truth in 90 % of cases."
    )
    measure_known_bounds(report)
    for case in CASES:
        measure_case(report, case, n, seed)
    measure_speed(report, np.random.default_rng(seed))


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", type=int, default=4000, help="tracks a row")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-docs", action="store_true", help="write docs/estimator.md")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, arguments.tracks, arguments.seed)
    if arguments.write_docs:
        report.write_docs("estimator.md", "How good the estimate of a whole track is")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
