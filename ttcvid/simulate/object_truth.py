"""The truth of an object in a picture: where it is seen, what of it is nearest, how that moves and when it arrives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats
from ttcvid.simulate.ripmap import Float32s
from ttcvid.simulate.truth import TrueTimes, true_times
from ttcvid.simulate.world import Actor, Pose

NEAREST_SHARE = 0.1
"""An object's times are those of its nearest tenth, what is hit first: a tenth of its points supports them."""
SURFACE_DEPTH = 0.01
"""Points at most this share of the depth behind the nearest tenth belong to the same surface."""


@dataclass(frozen=True)
class Visible:
    """The samples ``(H, W)`` of a window of the picture, and which of them show the object.

    ``outline`` are those that would show it if nothing stood before it; ``x, y`` are the samples' rays, ``corner`` is
    the window's first row and column, ``per_pixel`` the number of samples per pixel and axis.
    """

    mask: Bools
    outline: Bools
    x: Float32s
    y: Float32s
    inverse_depth: Float32s
    corner: tuple[int, int]
    per_pixel: int


@dataclass(frozen=True)
class ObjectTruth:
    """One object in one picture, in the camera of that picture.

    ``box_px`` (x0, y0, x1, y1) holds what is visible, ``visible_px`` its area, ``visible_fraction`` that over the area
    inside the picture if nothing stood before it; ``position_m`` (3,) is the centre of the nearest visible
    surface, ``velocity_m_s`` (3,) its relative velocity V; ``times`` has one row.
    """

    object_id: int
    name: str
    is_moving: bool
    box_px: tuple[float, float, float, float]
    visible_px: float
    visible_fraction: float
    position_m: Floats
    velocity_m_s: Floats
    times: TrueTimes


def object_truth(actor: Actor, pose: Pose, visible: Visible) -> ObjectTruth:
    """The truth of an actor of which at least one sample is visible."""
    position = nearest_surface_m(
        visible.x[visible.mask], visible.y[visible.mask], visible.inverse_depth[visible.mask].astype(float)
    )
    velocity = pose.velocity_of(position[None])
    n_visible = float(visible.mask.sum())
    return ObjectTruth(
        object_id=actor.object_id,
        name=actor.name,
        is_moving=actor.is_moving,
        box_px=_box_px(visible),
        visible_px=n_visible / visible.per_pixel**2,
        visible_fraction=n_visible / float(visible.outline.sum()),
        position_m=position,
        velocity_m_s=velocity[0],
        times=true_times(position[None], velocity),
    )


def nearest_surface_m(x: Floats | Float32s, y: Floats | Float32s, inverse_depth: Floats) -> Floats:
    """Centre (3,) of the nearest well-supported surface among visible points with rays (x, y, 1) ``(N,)``.

    On a plane parallel to the picture it is the plane's visible centre, not its extreme; of a receding side it is
    the nearest tenth. Inverse depths are averaged, because 1/time is proportional to them.
    """
    threshold = np.quantile(inverse_depth, 1 - NEAREST_SHARE) * (1 - SURFACE_DEPTH)
    near = inverse_depth >= threshold
    depth = 1 / float(inverse_depth[near].mean())
    return depth * np.array([float(x[near].mean(dtype=float)), float(y[near].mean(dtype=float)), 1.0])


def _box_px(visible: Visible) -> tuple[float, float, float, float]:
    """Outer edges of the visible samples, in pixels."""
    rows, columns = np.flatnonzero(visible.mask.any(axis=1)), np.flatnonzero(visible.mask.any(axis=0))
    first_row, first_column = visible.corner
    edges = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], float)
    edges += (first_column, first_row, first_column, first_row)
    x0, y0, x1, y1 = (edges / visible.per_pixel - 0.5).tolist()
    return x0, y0, x1, y1
