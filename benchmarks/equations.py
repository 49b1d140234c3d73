"""The eight equations on noise-free tracks: largest relative error over random, planar and degenerate motion.

python benchmarks/equations.py [--points 2000] [--seed 0] [--check]

Positions and velocities are drawn at random; truth is the closed formula in them, the input only what a camera would
see: unit rays or picture points at a few times. Each error is relative to the size of what is compared (1 for unit
vectors and angles). Flows that are nearly parallel to what they have to meet magnify rounding without limit: motion
within 5 deg of the ray, and points within 5 deg of the horizon for planar motion, are left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from consensus import epipoles_by_ransac
from epipole_of_flows import epipole_maximum_likelihood
from report import Bar, Report

from ttcvid.geometry.paper.collision import (
    angle_from_direction,
    collision_point,
    k_from_two_angles,
    times_from_position_velocity,
    times_from_state,
)
from ttcvid.geometry.paper.epipole import epipole_from_flow_lines
from ttcvid.geometry.paper.expansion import expansion_rate
from ttcvid.geometry.paper.flow_line import flow_line_chi2, flow_line_distance_px
from ttcvid.geometry.paper.planar import planar_epipole
from ttcvid.geometry.paper.three_frames import epipole_offset_three_frames, three_frame_direction
from ttcvid.geometry.paper.two_view_state import state_from_direction
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Floats

ERROR_BAR = Bar(1e-9)
GAP_1_S, GAP_2_S = 0.3, 0.5
LEAST_ANGLE_RAD = np.radians(5.0)
GROUND_NORMAL = np.array([0.0, -1.0, 0.0])
SIGMA_RAD = 1e-7
"""Noise that the estimators are told; there is none."""


@dataclass(frozen=True)
class Points:
    """N points in constant relative motion: P at the last view, in m, and V in m/s, (N, 3) each."""

    position_m: Floats
    velocity_m_s: Floats

    @property
    def direction(self) -> Floats:
        """``dir`` of each point."""
        return normalize(self.velocity_m_s)

    @property
    def sigma_rad(self) -> Floats:
        """The noise to tell, one a point."""
        return np.full(len(self.position_m), SIGMA_RAD)

    def rays(self, t_s: float) -> Floats:
        """Unit rays (N, 3) at a time, 0 the last view."""
        return normalize(self.position_m + t_s * self.velocity_m_s)

    def take(self, mask: Floats) -> Points:
        """Some of the points."""
        return Points(self.position_m[mask], self.velocity_m_s[mask])


def general(rng: np.random.Generator, n: int) -> Points:
    """Points before the camera, moving anyhow."""
    position_m = np.column_stack([rng.uniform(-20, 20, n), rng.uniform(-5, 5, n), rng.uniform(8, 80, n)])
    return _with_parallax(Points(position_m, rng.uniform(-9, 9, (n, 3))))


def planar(rng: np.random.Generator, n: int) -> Points:
    """The same, moving along the road, and seen above or below the horizon."""
    points = general(rng, n)
    velocity_m_s = points.velocity_m_s * (1.0, 0.0, 1.0)
    points = _with_parallax(Points(points.position_m, velocity_m_s))
    height = np.abs(points.rays(0.0) @ GROUND_NORMAL)
    return points.take(height > np.sin(LEAST_ANGLE_RAD))


def degenerate(rng: np.random.Generator, n: int) -> Points:
    """Epipoles at infinity and almost there, receding points, and points beside us that have passed their nearest."""
    points = general(rng, n)
    velocity_m_s = points.velocity_m_s.copy()
    kind = np.arange(len(velocity_m_s)) % 4
    velocity_m_s[kind == 0, 2] = 0.0
    velocity_m_s[kind == 1, 2] *= 1e-6
    velocity_m_s[kind == 2] = 0.3 * points.position_m[kind == 2] + (4.0, 0.0, 0.0)
    velocity_m_s[kind == 3] = points.position_m[kind == 3] * (1.0, 0.2, 0.0) + (9.0, 0.0, 0.0)
    return _with_parallax(Points(points.position_m, velocity_m_s))


def _with_parallax(points: Points) -> Points:
    before = points.position_m - (GAP_1_S + GAP_2_S) * points.velocity_m_s
    sine = np.linalg.norm(np.cross(points.rays(0.0), points.direction), axis=1)
    return points.take((before[:, 2] > 1.0) & (sine > np.sin(LEAST_ANGLE_RAD)))


def largest_error(found: Floats, truth: Floats, size: Floats | float | None = None) -> float:
    """Largest difference relative to ``size`` (default: the truth's own); a missing value counts as infinite."""
    scale = np.abs(truth) if size is None else size
    error = np.abs(found - truth) / scale
    return float(np.max(np.where(np.isnan(error), np.inf, error)))


def equation_1(p: Points) -> float:
    """Angle from the epipole: of 3-D rays against the arc tangent of miss over tcpa."""
    times = times_from_position_velocity(p.position_m, p.velocity_m_s)
    ray = p.rays(0.0)
    angle = angle_from_direction(ray, -p.direction, np.cross(-p.direction, ray))
    return largest_error(angle, np.arctan2(times.miss_s, times.tcpa_s), 1.0)


def equation_2(p: Points) -> float:
    """Time k from two angles, at the first view: relative to k or the gap, whichever is larger."""
    first, last = p.rays(-GAP_1_S), p.rays(0.0)
    normal = np.cross(-p.direction, first)
    alpha, beta = (angle_from_direction(ray, -p.direction, normal) for ray in (first, last))
    k_s, _ = k_from_two_angles(alpha, beta, GAP_1_S)
    truth_s = _tcpa_s(p) + GAP_1_S
    return largest_error(k_s, truth_s, np.maximum(np.abs(truth_s), GAP_1_S))


def equation_3(p: Points) -> float:
    """Planar motion: the flow line meets the horizon at dir."""
    direction, _, _ = planar_epipole(
        p.rays(-GAP_1_S), p.rays(0.0), GROUND_NORMAL, p.sigma_rad, SIGMA_RAD**2 * np.eye(3)
    )
    return largest_error(direction, p.direction, 1.0)


def equation_4(p: Points) -> float:
    """(k, H) and P' = P / |V|: from P and V, and from the state of two views."""
    speed = np.linalg.norm(p.velocity_m_s, axis=1)
    truth = p.position_m / speed[:, None]
    size = np.linalg.norm(truth, axis=1, keepdims=True)
    state, _, _ = state_from_direction(p.rays(-GAP_1_S), p.rays(0.0), p.direction, GAP_1_S, p.sigma_rad)
    errors = []
    for times in (times_from_position_velocity(p.position_m, p.velocity_m_s), times_from_state(state)):
        found = collision_point(p.rays(0.0), p.direction, times.tcpa_s, times.miss_s)
        errors.append(largest_error(found, truth, size))
    return max(errors)


def equation_5(p: Points) -> float:
    """One epipole of many flows: pseudo-inverse in the picture, and maximum likelihood on the sphere."""
    flock = _one_velocity(p)
    first, last = flock.rays(-GAP_1_S), flock.rays(0.0)
    direction, _, _, _ = epipole_maximum_likelihood(first, last, flock.sigma_rad)
    error = largest_error(direction, flock.direction[0], 1.0)
    if abs(flock.direction[0, 2]) < LEAST_ANGLE_RAD:
        return error
    epipole, _ = epipole_from_flow_lines(_in_picture(first), _in_picture(last))
    truth = _in_picture(flock.direction[:1])[0]
    return max(error, largest_error(epipole, truth, max(1.0, float(np.linalg.norm(truth)))))


def equation_6(p: Points) -> float:
    """Distance from a flow line to its epipole: none, in picture and sigmas; epipoles of two motions by RANSAC."""
    first, last = p.rays(-GAP_1_S), p.rays(0.0)
    chi2 = np.diag(flow_line_chi2(p.direction, first, last, np.ones(len(first))))
    error = largest_error(np.sqrt(chi2), np.zeros(len(chi2)), 1.0)
    is_in_picture = np.abs(p.direction[:, 2]) > LEAST_ANGLE_RAD
    for d, q, r in zip(p.direction[is_in_picture], first[is_in_picture], last[is_in_picture], strict=True):
        epipole = _in_picture(d[None])[0]
        distance = flow_line_distance_px(epipole, _in_picture(q[None]), _in_picture(r[None]))
        error = max(error, largest_error(distance, np.zeros(1), max(1.0, float(np.linalg.norm(epipole)))))
    return max(error, _two_motions(p))


def _two_motions(p: Points) -> float:
    """Of the epipoles found among flows of two velocities, the farthest from both true ones."""
    one, other = _one_velocity(p), _one_velocity(Points(p.position_m[::-1], p.velocity_m_s[::-1]))
    first, last = (np.concatenate([one.rays(t_s), other.rays(t_s)]) for t_s in (-GAP_1_S, 0.0))
    groups = epipoles_by_ransac(first, last, np.full(len(first), SIGMA_RAD), GAP_1_S, np.random.default_rng(0))
    truth = one.direction[0], other.direction[0]
    is_found = [any(g.direction @ direction > 0.999 for g in groups) for direction in truth]
    if not all(is_found):
        return float(np.inf)
    return max(min(largest_error(g.direction, direction, 1.0) for direction in truth) for g in groups)


def equation_7(p: Points) -> float:
    """Three views: the offset of the angles from an arbitrary reference, direction and k."""
    views = np.stack([p.rays(-GAP_1_S - GAP_2_S), p.rays(-GAP_2_S), p.rays(0.0)])
    normal = normalize(np.cross(views[0], views[2]))
    tangents = [np.tan(angle_from_direction(ray, views[1], normal)) for ray in views]
    offset = epipole_offset_three_frames(*tangents, GAP_1_S, GAP_2_S)
    truth = angle_from_direction(views[1], -p.direction, normal)
    error = largest_error(np.sin(offset - truth), np.zeros(len(offset)), 1.0)
    direction, k_s, _ = three_frame_direction(views, GAP_1_S, GAP_2_S, 1e-6 * p.sigma_rad)
    truth_s = _tcpa_s(p)
    k_error = largest_error(k_s, truth_s, np.maximum(np.abs(truth_s), GAP_1_S))
    return max(error, largest_error(direction, p.direction, 1.0), k_error)


def equation_8(p: Points) -> float:
    """Constant bearing: time from the expansion of a square that keeps its distance relations around each point."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    approach = -p.position_m * np.linspace(0.02, 0.5, len(p.position_m))[:, None]
    last = p.position_m[:, None] + corners
    expansion_hz, _ = expansion_rate(last - GAP_1_S * approach[:, None], last, GAP_1_S)
    return largest_error(1.0 / expansion_hz, -p.position_m[:, 2] / approach[:, 2])


def _tcpa_s(p: Points) -> Floats:
    """Time of closest approach by its definition, without the package."""
    along = np.einsum("ni,ni->n", p.position_m, p.velocity_m_s)
    return -along / np.einsum("ni,ni->n", p.velocity_m_s, p.velocity_m_s)


def _one_velocity(p: Points) -> Points:
    """The points with the velocity of the first, as far as they keep a parallax."""
    return _with_parallax(Points(p.position_m, np.broadcast_to(p.velocity_m_s[0], p.position_m.shape)))


def _in_picture(rays: Floats) -> Floats:
    return rays[:, :2] / rays[:, 2:]


EQUATIONS: tuple[Callable[[Points], float], ...] = (
    equation_1,
    equation_2,
    equation_3,
    equation_4,
    equation_5,
    equation_6,
    equation_7,
    equation_8,
)
MOTIONS: dict[str, Callable[[np.random.Generator, int], Points]] = {
    "general": general,
    "planar": planar,
    "degenerate": degenerate,
}


def measure(report: Report, n_points: int = 2000, seed: int = 0) -> None:
    """One line an equation: its largest relative error over all kinds of motion."""
    report.heading("The eight equations on noise-free tracks")
    report.command(["python", "benchmarks/equations.py", "--points", str(n_points), "--seed", str(seed)])
    kinds = {name: make(np.random.default_rng([seed, i]), n_points) for i, (name, make) in enumerate(MOTIONS.items())}
    for number, equation in enumerate(EQUATIONS, 1):
        asked = {"planar": kinds["planar"]} if equation is equation_3 else kinds
        errors = {name: equation(points) for name, points in asked.items()}
        parts = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
        what = (equation.__doc__ or "").split(":")[0].rstrip(".")
        report.figure(f"equation {number}, {what} ({parts})", max(errors.values()), "", ERROR_BAR)


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, arguments.points, arguments.seed)
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
