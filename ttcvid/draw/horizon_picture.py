"""The picture of a horizon calibration: tracks, epipoles with their ellipses, the line with its band."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.horizon.line import HorizonFit, band_px
from ttcvid.geometry.paper.epipole import INFINITY_COSINE
from ttcvid.model import Camera, Floats, Picture
from ttcvid.stages.horizon.straight_motion import Motion
from ttcvid.stages.horizon.whole_tracks import Observations

# Margin around the picture in which epipoles are shown, in picture widths and heights.
_MARGIN = (0.5, 0.5)
# Radius of an ellipse that holds 95 % of a 2-D Gaussian, in standard deviations.
_SIGMAS_95_OF_TWO = 2.4477
_WIDTH_INCHES, _DPI = 12.0, 100
# Of the title: characters that surely fit into a line, height of a line.
_TITLE_POINTS, _TITLE_CHARACTERS, _LINE_INCHES = 10, 130, 0.2
_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple", "tab:brown", "tab:pink", "tab:olive", "tab:cyan")
_REFUSED = "0.55"


def write_horizon_picture(
    path: Path,
    camera: Camera,
    fit: HorizonFit,
    motions: tuple[Motion, ...],
    rows: Observations,
    background: Picture | None,
    title: str,
) -> None:
    """Write a PNG of the undistorted picture plane around the picture; OSError where it cannot be written.

    Parameters
    ----------
    rows : observations of the tracks to be drawn, of the first clip.
    background : (H, W) uint8 a picture of the first clip, drawn as it is; None: plain.
    """
    width, height = camera.image_size.width_px, camera.image_size.height_px
    left, right = -_MARGIN[0] * width, (1 + _MARGIN[0]) * width
    top, bottom = -_MARGIN[1] * height, (1 + _MARGIN[1]) * height
    # Title and labels take their place beside the axes, whatever their length.
    lines = textwrap.wrap(title, _TITLE_CHARACTERS)
    height_inches = _WIDTH_INCHES * (bottom - top) / (right - left) + _LINE_INCHES * len(lines)
    figure = Figure(figsize=(_WIDTH_INCHES, height_inches), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_facecolor("0.93")
    if background is not None:
        axes.imshow(background, cmap="gray", vmin=0, vmax=255, alpha=0.75)
    axes.plot([0, width - 1, width - 1, 0, 0], [0, 0, height - 1, height - 1, 0], color="black", linewidth=0.8)
    for number, motion in enumerate(motions):
        is_used = motion.status == "used"
        colour = _COLOURS[number % len(_COLOURS)] if is_used else _REFUSED
        if motion.clip == 0:
            _draw_tracks(axes, camera, motion, rows, colour)
        _draw_epipole(axes, camera, motion, colour)
    x_px = np.linspace(left, right, 200)
    y_px, half_px = band_px(camera, fit, x_px)
    axes.fill_between(x_px, y_px - half_px, y_px + half_px, color="red", alpha=0.2, linewidth=0)
    axes.plot(x_px, y_px, color="red", linewidth=1.5)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_xlabel("x, px")
    axes.set_ylabel("y, px")
    axes.set_title("\n".join(lines), fontsize=_TITLE_POINTS)
    figure.savefig(path, format="png", metadata={"Software": None})


def _draw_tracks(axes, camera: Camera, motion: Motion, rows: Observations, colour: str) -> None:  # type: ignore[no-untyped-def]
    in_motion = (rows.frame >= motion.first_frame) & (rows.frame <= motion.last_frame)
    mine = rows.take(in_motion & np.isin(rows.track_id, motion.track_id))
    if not len(mine.frame):
        return
    xy_px = _undistorted_px(camera, rays_from_pixels(camera, mine.xy_px))
    for start, length in zip(mine.starts, mine.lengths, strict=True):
        axes.plot(*xy_px[start : start + length].T, color=colour, linewidth=0.8, alpha=0.8)


def _draw_epipole(axes, camera: Camera, motion: Motion, colour: str) -> None:  # type: ignore[no-untyped-def]
    direction = motion.direction
    if not abs(direction[2]) > INFINITY_COSINE:
        return
    (centre,) = _undistorted_px(camera, direction[None])
    by_direction = np.array(
        [
            [camera.fx_px / direction[2], 0.0, -camera.fx_px * direction[0] / direction[2] ** 2],
            [0.0, camera.fy_px / direction[2], -camera.fy_px * direction[1] / direction[2] ** 2],
        ]
    )
    values, vectors = np.linalg.eigh(by_direction @ motion.covariance @ by_direction.T)
    axis_px = 2.0 * _SIGMAS_95_OF_TWO * np.sqrt(np.maximum(values, 0.0))
    angle_deg = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    axes.add_patch(Ellipse((centre[0], centre[1]), axis_px[1], axis_px[0], angle=angle_deg, fill=False, color=colour))
    axes.plot(*centre, marker="+" if motion.status == "used" else "x", color=colour, markersize=9)


def _undistorted_px(camera: Camera, rays: Floats) -> Floats:
    result: Floats = rays[:, :2] / rays[:, 2:] * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)
    return result
