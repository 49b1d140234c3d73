"""Bodies that move in straight lines before a resting camera, as tracks with known direction."""

import numpy as np

from ttcvid.geometry.estimation.moving_body import BodyTracks

FOCAL_PX, FPS = 500.0, 25.0


def body_tracks(
    rng,
    heading_rad,
    *,
    n_tracks=15,
    n_frames=50,
    sigma_px=0.3,
    turn_rad_s=0.0,
    bob_px=0.0,
    slide_px_s=0.0,
    speed_m_s=6.0,
):
    """Tracks of a box of 4 x 1.4 x 2 m some 20 m away on level ground; the camera looks level.

    ``bob_px`` moves all points up and down together twice a second, ``slide_px_s`` lets each drift its own way.
    """
    direction = np.array([np.sin(heading_rad), 0.0, np.cos(heading_rad)])
    across = np.array([np.cos(heading_rad), 0.0, -np.sin(heading_rad)])
    centre = np.array([rng.uniform(-6, 6), 1.5, rng.uniform(16, 26)])
    points = centre + rng.uniform([-2, -1.4, -1], [2, 0, 1], (n_tracks, 3))
    t_s = np.arange(n_frames) / FPS
    tau = t_s - t_s.mean()
    if turn_rad_s:
        angle = turn_rad_s * tau
        along_m, aside_m = speed_m_s * np.sin(angle) / turn_rad_s, speed_m_s * (1 - np.cos(angle)) / turn_rad_s
    else:
        along_m, aside_m = speed_m_s * tau, 0.0 * tau
    path_m = along_m[:, None] * direction + aside_m[:, None] * across
    rows = []
    phase = rng.uniform(0, 2 * np.pi)
    for number, point in enumerate(points):
        first, last = sorted(rng.choice(n_frames, 2, replace=False))
        if last - first < n_frames // 2:
            first, last = 0, n_frames
        seen = slice(first, last)
        place = point + path_m[seen]
        xy = place[:, :2] / place[:, 2:]
        xy += sigma_px / FOCAL_PX * rng.standard_normal(xy.shape)
        xy[:, 1] += bob_px / FOCAL_PX * np.sin(2 * np.pi * 2.0 * t_s[seen] + phase)
        xy += slide_px_s / FOCAL_PX * rng.standard_normal(2) * (t_s[seen] - t_s[seen].mean())[:, None]
        rows.append((np.full(len(place), number), t_s[seen], xy))
    number, t, xy = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    return BodyTracks(number, t, xy, max(sigma_px, 1e-3) / FOCAL_PX), direction
