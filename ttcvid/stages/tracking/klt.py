"""Points followed from picture to picture by pyramidal Lucas-Kanade, checked forth and back.

A track stands where the content of its window lay when it began, and keeps that distance from the window: in what
comes nearer the content stays with its surface, and the middle of the window does not (`stages.tracking.content`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial import KDTree

from ttcvid.config import TrackingConfig
from ttcvid.geometry.medians import median
from ttcvid.model import NO_POINTS, Bools, Floats, Ints, Picture, PointSet
from ttcvid.stages.tracking.changes import changed_places
from ttcvid.stages.tracking.content import content_offsets
from ttcvid.stages.tracking.corners import find_corners, find_corners_where

# Lucas-Kanade ends after so many iterations or when a step is shorter than this, px. Ended at 0.03 px it leaves errors
# that make slow things (an aircraft far away) a third less accurate; for the check by the way back it is enough.
_ITERATIONS, _STEP_PX, _BACKWARD_STEP_PX = 20, 0.01, 0.03
# So far from its goal the way back starts, px: about as far as the full picture alone leads back from.
_BACKWARD_START_PX = 1.5
# How far off the guess most points are is seen by so many of them, in pictures of this part of the size with so many
# levels above.
_SAMPLED_POINTS, _SAMPLED_SCALE, _SAMPLED_LEVELS = 64, 0.25, 2
# A turn of the camera is looked for where most points are farther off their guess than this, px: from less, the fine
# pictures lead back. Small pictures show places to some 3 px only, and it has to be twice as much.
_LEAST_TURN_PX, _LEAST_SAMPLED_PX = 3.0, 6.0
# A turn has to take half of the points along, so many at the least. It takes a point along that is left within so many
# px, or within this part of what most were off: a wide angle stretches a turn towards the border.
_LEAST_ALIKE, _ALIKE_PX, _ALIKE_PART = 8, 3.0, 0.5
# A point stays at its guess if its window differs from the picture there by less than this part of what it differs by
# where the turn takes it.
_MUCH_MORE_ALIKE = 0.5
# Times between pictures within this part of each other are the same.
_SAME_STEP = 0.2
# Levels above the full picture on which a point is looked for where it should be by now. Not where most points are
# lost, as at a cut: fine pictures find something similar anywhere.
_FINE_LEVELS = 1
# Where more are found, those that are lost are mostly gone for good: of 80, coarse pictures find some 3 again, for a
# fifth of the time of tracking.
_MOST_FOUND = 0.875
# Two tracks in one cell of this side follow the same point, px.
_CROWDED_PX = 2.0
# New corners are looked for when the live tracks fall below this part of the wanted number: on a drive at 10 Hz in
# every third picture. More often, the search costs as much as following all tracks back. Before a camera at rest hardly
# any die, and what comes into the picture would have none for seconds: there they are looked for after so many.
_TOP_UP_BELOW, _TOP_UP_AFTER = 0.8, 3
# Part of the tracks that the street needs before a camera at rest; the others are for what moves.
_STREET_PART = 0.5
# Before a camera at rest half of the points step less than this from picture to picture, px; so they do before one that
# is slow for its frame rate, where new tracks are as scarce.
_RESTING_STEP_PX = 1.0
# A codec has copied a window if so many of its pixels are those of the last picture. What stepped less than this
# before, px, stands: its copy is where it is. Where most of the windows are copied, the camera stands.
_COPIED_PART, _STANDS_PX = 0.9, 0.5


@dataclass(frozen=True)
class KltMemory:
    """What is remembered between two pictures: the last one, its points with their windows, and their last step.

    ``step_px (N, 2)`` is NaN for a point that has made none yet; ``n_copied (N,)`` counts the pictures since its window
    was last seen anew; ``looked`` is the picture in which corners were looked for last, ``n_since`` pictures ago.
    """

    grey: Picture
    points: PointSet
    step_px: Floats
    next_track_id: int
    looked: Picture
    n_copied: Ints
    n_since: int = 0

    @cached_property
    def seen(self) -> PointSet:
        """The points that are observed in the last picture.

        A codec copies what it does not send, to the same place: a copied window shows where its point was. That is an
        observation only of what stood before, or where the whole picture stands. A new point is taken to go with most.
        """
        length_px = np.hypot(*self.step_px.T)
        is_new = np.isnan(length_px)
        length_px[is_new] = median(length_px[~is_new]) if not is_new.all() else 0.0
        is_seen = (self.n_copied == 0) | (length_px < _STANDS_PX)
        if 2 * np.count_nonzero(self.n_copied) > len(is_seen):
            is_seen[:] = True
        return replace(self.points, unseen_id=self.points.track_id[~is_seen]).take(is_seen)

    def take(self, tracks: Bools) -> KltMemory:
        """The same with the tracks of a mask ``(N,)`` only."""
        step_px, n_copied = self.step_px[tracks], self.n_copied[tracks]
        return replace(self, points=self.points.take(tracks), step_px=step_px, n_copied=n_copied)


def start_klt(grey: Picture, allowed: Picture | None, config: TrackingConfig, next_track_id: int = 0) -> KltMemory:
    """Fresh corners on a first picture (or the first one after a cut)."""
    nothing = KltMemory(grey, NO_POINTS, np.empty((0, 2)), next_track_id, grey, np.empty(0, dtype=np.int64))
    return _topped_up(nothing, allowed, config, camera_rests=False)


def follow_klt(
    memory: KltMemory,
    grey: Picture,
    allowed: Picture | None,
    config: TrackingConfig,
    *,
    camera_rests: bool = False,
    step_part: float = 1.0,
) -> tuple[KltMemory, float]:
    """Follow the points of ``memory`` into ``grey`` and top them up: where the ``camera_rests``, where it changes.

    ``step_part`` is the time since the last picture over that before it. Returns also the part of the points that were
    found again (1 where there were none): low after a cut.
    """
    before_px, window = memory.points.windows_px, (config.window_px, config.window_px)
    # Part of the window about each pixel that is the same in both pictures, 0 to 255.
    copies = np.asarray(cv2.blur(cv2.compare(memory.grey, grey, cv2.CMP_EQ), window), dtype=np.uint8)
    is_copied = _are_copied(copies, before_px)
    found, window_px = _search(memory, grey, is_copied, step_part, config)
    xy_px = window_px + (memory.points.xy_px - before_px)
    found &= _is_inside(xy_px, grey)
    if allowed is not None:
        found &= _is_allowed(allowed, window_px) & _is_allowed(allowed, xy_px)
    found &= ~_is_crowded(window_px, found)
    points = replace(memory.points, xy_px=xy_px, window_px=window_px)
    n_copied = np.where(is_copied, memory.n_copied + 1, 0)
    step_px = (window_px - before_px) / (1.0 + memory.n_copied[:, None])
    step_px = np.where(is_copied[:, None], memory.step_px, step_px)
    followed = replace(memory, grey=grey, points=points, step_px=step_px, n_copied=n_copied, n_since=memory.n_since + 1)
    followed = _topped_up(followed.take(found), allowed, config, camera_rests)
    # What begins in a copy is not seen yet, either.
    begins = followed.points.track_id >= memory.next_track_id
    n_copied = np.where(begins, _are_copied(copies, followed.points.windows_px), followed.n_copied)
    return replace(followed, n_copied=n_copied), float(found.mean()) if len(found) else 1.0


def _are_copied(copies: Picture, window_px: Floats) -> Bools:
    """Whether the windows at ``window_px (N, 2)`` are copied."""
    column, row = np.rint(window_px).astype(np.intp).T
    return np.asarray(copies[row, column] > 255.0 * _COPIED_PART)


def _search(
    memory: KltMemory, grey: Picture, is_copied: Bools, step_part: float, config: TrackingConfig
) -> tuple[Bools, Floats]:
    """Windows forward from where they should be by now, then back from where they ended: (N,) found, (N, 2) px.

    Those that ``is_copied (N,)`` stay. ``step_part`` as of `follow_klt`.
    """
    windows_px = memory.points.windows_px
    before = windows_px.astype(np.float32)
    step_px = np.nan_to_num(memory.step_px) * (1.0 + memory.n_copied[:, None])
    guess = (windows_px + step_px).astype(np.float32)
    found, there = is_copied.copy(), np.where(is_copied[:, None], before, guess)

    def look_for(which: Ints, start: np.ndarray, levels: int) -> None:
        if len(which):
            found[which], there[which] = _there_and_back(memory.grey, grey, before[which], start, config, levels)

    # Where a point should be by now the fine pictures find it, in less time. The coarse ones of the pyramid show what
    # is large near it: a post that sweeps over a car takes all of the car's points along, far beyond itself. They are
    # for points that have made no step yet, and for those that have changed theirs.
    is_new = np.isnan(memory.step_px[:, 0])
    expected = np.flatnonzero(~is_new & ~is_copied)
    guess[expected] = _expected_px(memory.grey, grey, before[expected], step_px[expected], step_part, config)
    fine_levels = min(_FINE_LEVELS, config.pyramid_levels)
    look_for(expected, guess[expected], fine_levels)
    seen = expected[found[expected]]
    n_found = len(seen)
    there[seen] = _put_right(memory.grey, grey, before[seen], guess[seen], there[seen], config, fine_levels)
    if 2 * n_found < len(expected):
        found[expected] = False
    if is_new.any() or n_found < _MOST_FOUND * len(expected):
        lost = np.flatnonzero(~found)
        look_for(lost, guess[lost], config.pyramid_levels)
    # On something small and fast the coarse pictures lead most new points astray. Those that came through show where
    # the others have gone. Not before a camera in motion: there they would lead corners of outlines, where two surfaces
    # meet, along with either.
    lost = np.flatnonzero(is_new & ~found)
    steps_px = (there - before)[found]
    if len(lost) and _stands_nearly(steps_px):
        _, nearest = KDTree(before[found]).query(before[lost])
        start = before[lost] + steps_px[nearest]
        is_far = np.linalg.norm(start - before[lost], axis=1) > config.window_px
        look_for(lost[is_far], start[is_far], fine_levels)
    return found, there.astype(np.float64)


def _expected_px(
    one: Picture, other: Picture, before: np.ndarray, step_px: np.ndarray, step_part: float, config: TrackingConfig
) -> np.ndarray:
    """Where points ``before (N, 2)`` should be that stepped by ``step_px (N, 2)``: (N, 2) float32 px.

    After ``step_part`` times as long they have made as much of that step, unless a sample of them shows that they have
    made it once more (times may be wrong). A turn that takes most of the sample along moves all guesses, but for points
    that are clearly seen at theirs: a shaken camera moves all points, a lorry before a mast only its own.
    """
    parts = [1.0] if abs(step_part - 1.0) < _SAME_STEP else [step_part, 1.0]
    guesses = [(before + part * step_px).astype(np.float32) for part in parts]
    small_one, small_other = (
        np.asarray(cv2.resize(grey, None, fx=_SAMPLED_SCALE, fy=_SAMPLED_SCALE, interpolation=cv2.INTER_AREA), np.uint8)
        for grey in (one, other)
    )
    samples = [_sampled(small_one, small_other, before, guess, config) for guess in guesses]
    off_px = [np.linalg.norm(there - expected, axis=1) for expected, there in samples]
    best = int(np.argmin([median(off) if len(off) else np.inf for off in off_px]))
    guess, move = guesses[best], _common_move(*samples[best], _LEAST_SAMPLED_PX)
    if move is None:
        return guess
    moved = _moved(move, guess)
    off, moved_off = (_unlikeness(one, other, before, place, config) for place in (guess, moved))
    return np.where((off < _MUCH_MORE_ALIKE * moved_off)[:, None], guess, moved)


def _sampled(
    small_one: Picture, small_other: Picture, before: np.ndarray, guess: np.ndarray, config: TrackingConfig
) -> tuple[np.ndarray, np.ndarray]:
    """The ``guess (N, 2)`` of some of the points ``before (N, 2)``, and where small pictures show them: (M, 2) each."""
    if not len(before):
        return before, before
    some, scale = slice(None, None, -(-len(before) // _SAMPLED_POINTS)), _SAMPLED_SCALE
    # The middle of the top-left pixel is (0, 0) at any size.
    start, expected = ((xy_px[some] + 0.5) * scale - 0.5 for xy_px in (before, guess))
    found, there = _follow(
        small_one, small_other, start, expected, config.window_px, _SAMPLED_LEVELS, _BACKWARD_STEP_PX
    )
    return guess[some][found], (there[found] + 0.5) / scale - 0.5


def _common_move(guess: np.ndarray, there: np.ndarray, least_px: float) -> np.ndarray | None:
    """The similarity (2, 3) from the ``guess (N, 2)`` of most points to where they are, ``there (N, 2)``.

    None where most guesses are less than ``least_px`` off, or no similarity takes half of the points along.
    """
    if len(guess) < _LEAST_ALIKE:
        return None
    off_px = float(np.median(np.linalg.norm(there - guess, axis=1)))
    if off_px < least_px:
        return None
    move, _ = cv2.estimateAffinePartial2D(guess, there, ransacReprojThreshold=_ALIKE_PX)
    if move is None:
        return None
    left_px = np.linalg.norm(there - _moved(move, guess), axis=1)
    is_alike = left_px < max(_ALIKE_PX, _ALIKE_PART * off_px)
    return move if np.count_nonzero(is_alike) >= max(_LEAST_ALIKE, 0.5 * len(guess)) else None


def _moved(move: np.ndarray, xy_px: np.ndarray) -> np.ndarray:
    """Where a similarity ``move (2, 3)`` takes points (N, 2): (N, 2) float32."""
    return np.asarray(xy_px @ move[:, :2].T + move[:, 2], dtype=np.float32)


def _put_right(
    one: Picture,
    other: Picture,
    before: np.ndarray,
    guess: np.ndarray,
    there: np.ndarray,
    config: TrackingConfig,
    levels: int,
) -> np.ndarray:
    """Places of points found ``there (N, 2)``, those put right that a turn of the camera has led astray: (N, 2) px.

    Windows of a house are found where their neighbours are, and the way back leads each of them home. Those that do not
    go with most points are looked for again from where these go, and stay there if the picture looks more like that
    ``before (N, 2)``.
    """
    move = _common_move(guess, there, _LEAST_TURN_PX)
    if move is None:
        return there
    start = _moved(move, guess)
    astray = np.flatnonzero(np.linalg.norm(there - start, axis=1) > _ALIKE_PX)
    if not len(astray):
        return there
    found, again = _there_and_back(one, other, before[astray], start[astray], config, levels)
    off, off_again = (_unlikeness(one, other, before[astray], place, config) for place in (there[astray], again))
    is_right = found & (off_again < off)
    put_right = there.copy()
    put_right[astray[is_right]] = again[is_right]
    return put_right


def _unlikeness(
    one: Picture, other: Picture, before: np.ndarray, there: np.ndarray, config: TrackingConfig
) -> np.ndarray:
    """Mean absolute difference of the windows at ``before (N, 2)`` and ``there (N, 2)``, grey levels: (N,).

    Infinite for a window without texture and for one outside the picture.
    """
    # Without iterations, Lucas-Kanade tells the error at the start.
    _, status, difference = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        before,
        there.copy(),
        winSize=(config.window_px, config.window_px),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT, 0, 0.0),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.where(status.ravel() > 0, difference.ravel(), np.inf)


def _stands_nearly(step_px: np.ndarray) -> bool:
    """Whether most points, of steps (N, 2), stand nearly still."""
    step_px = step_px.astype(np.float64)
    return bool(len(step_px) and median(np.sqrt((step_px * step_px).sum(axis=1))) < _RESTING_STEP_PX)


def _there_and_back(
    one: Picture, other: Picture, before: np.ndarray, guess: np.ndarray, config: TrackingConfig, levels: int
) -> tuple[Bools, np.ndarray]:
    """Points ``before (N, 2)`` float32 of one picture in the other, from a guess on: (N,) found, (N, 2) px."""
    found, there = _follow(one, other, before, guess, config.window_px, levels, _STEP_PX)
    # The way back starts beside its goal, on the side of the error of the guess, and not at the goal: a jump to a
    # similar texture nearby is found out only like this. So near it needs no pyramid, which is most of the time.
    error = there - guess
    length_px = np.linalg.norm(error, axis=1, keepdims=True)
    start = before + error * (_BACKWARD_START_PX / np.maximum(length_px, _BACKWARD_START_PX))
    came_back, back = _follow(other, one, there, start, config.window_px, 0, _BACKWARD_STEP_PX)
    distance = np.linalg.norm(back - before, axis=1)
    return found & came_back & _is_inside(there, other) & (distance < config.max_forward_backward_px), there


def _is_inside(xy_px: np.ndarray, grey: Picture) -> Bools:
    """Points in the picture: (N,)."""
    height, width = grey.shape[:2]
    return np.asarray((xy_px >= 0).all(axis=1) & (xy_px[:, 0] <= width - 1) & (xy_px[:, 1] <= height - 1))


def _follow(
    one: Picture, other: Picture, xy_px: np.ndarray, start_px: np.ndarray, window_px: int, levels: int, step_px: float
) -> tuple[Bools, np.ndarray]:
    """Points (N, 2) float32 of one picture looked for in the other from ``start_px`` on: (N,) found, (N, 2) px."""
    to, status, _ = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        xy_px,
        start_px.copy(),
        winSize=(window_px, window_px),
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ITERATIONS, step_px),
        # Asked for eigenvalues, it does not work out the error of each window, which nobody looks at.
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW | cv2.OPTFLOW_LK_GET_MIN_EIGENVALS,
    )
    return status.ravel() > 0, to


def _is_allowed(allowed: Picture, xy_px: Floats) -> Bools:
    """Where the mask lets points live: (N,); a point outside the picture is not allowed."""
    inside = _is_inside(np.rint(xy_px), allowed)
    column, row = np.rint(xy_px[inside]).astype(np.intp).T
    inside[inside] = allowed[row, column] > 0
    return inside


def _is_crowded(xy_px: Floats, found: Bools) -> Bools:
    """Tracks (N,), in the order of their age, that slid into the cell of an older one: two would count twice."""
    candidates = np.flatnonzero(found)
    # One number a cell: rows of two take numpy several times as long to compare.
    cells = np.floor(xy_px[candidates] / _CROWDED_PX) @ (1.0, 1.0j)
    _, oldest = np.unique(cells, return_index=True)
    crowded = found.copy()
    crowded[candidates[oldest]] = False
    return crowded


def _topped_up(memory: KltMemory, allowed: Picture | None, config: TrackingConfig, camera_rests: bool) -> KltMemory:
    """Add corners once too many tracks have died, or at rest, where something new may be, once some pictures passed."""
    grey, windows_px, n_live = memory.grey, memory.points.windows_px, len(memory.points.track_id)
    step_px = memory.step_px[np.isfinite(memory.step_px[:, 0])]
    has_many = n_live >= _TOP_UP_BELOW * config.max_tracks * (_STREET_PART if camera_rests else 1.0)
    if has_many and not (memory.n_since >= _TOP_UP_AFTER and _stands_nearly(step_px)):
        return memory
    changed = changed_places(memory.looked, grey) if has_many and camera_rests else None
    if changed is not None:
        # The youngest of the tracks where nothing has changed, beyond those that the street needs, make room: left
        # behind by what went on, they would take the place of what moves.
        stands = ~_is_allowed(changed, windows_px)
        memory = memory.take(~stands | (np.cumsum(stands) <= int(_STREET_PART * config.max_tracks)))
        where = changed if allowed is None else np.minimum(changed, allowed)
        windows_px = memory.points.windows_px
        n_wanted = config.max_tracks - len(windows_px)
        new_px = find_corners_where(grey, where, windows_px, n_wanted, config.min_distance_px)
    else:
        n_wanted = config.max_tracks - n_live
        last_px = None if camera_rests else memory.step_px
        new_px = find_corners(grey, allowed, windows_px, n_wanted, config, only_new_places=has_many, step_px=last_px)
    return _with_new(memory, allowed, new_px, config)


def _with_new(memory: KltMemory, allowed: Picture | None, new_px: Floats, config: TrackingConfig) -> KltMemory:
    """The tracks, and those that begin at corners ``new_px (M, 2)`` of the picture."""
    grey, points = memory.grey, memory.points
    offset_px = content_offsets(grey, new_px, config.window_px)
    content_px = new_px + np.nan_to_num(offset_px)
    is_visible = _is_inside(content_px, grey) if allowed is None else _is_allowed(allowed, content_px)
    content_px = np.where(is_visible[:, None], content_px, new_px)
    next_track_id = memory.next_track_id + len(new_px)
    joined = PointSet(
        np.concatenate([points.track_id, np.arange(memory.next_track_id, next_track_id)]),
        np.concatenate([points.xy_px, content_px]),
        np.concatenate([points.windows_px, new_px]),
    )
    step_px = np.concatenate([memory.step_px, np.full_like(new_px, np.nan)])
    n_copied = np.append(memory.n_copied, np.zeros(len(new_px), dtype=np.int64))
    return KltMemory(grey, joined, step_px, next_track_id, looked=grey, n_copied=n_copied)
