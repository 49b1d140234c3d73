"""Single observations that have nothing to do with their track: they belong to nothing, and spoil nothing."""

from dataclasses import replace

import numpy as np
from tables_of_points import driving, results_of, street, table

from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Status

DISPLACED_FRAME, OFF_PX = 18, 8.0
FRAMES = table([street()], driving(10.0), 22, sigma_px=0.2)


def displaced(frames, index, share=0.1):
    """The frames, in one of which some tracks of long standing are seen in a wrong place; and which those are."""
    points = frames[index].points
    old = np.flatnonzero(np.isin(points.track_id, frames[index - 10].points.track_id))
    chosen = np.random.default_rng(1).choice(old, int(share * len(old)), replace=False)
    angle = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, len(chosen))
    xy_px = points.xy_px.copy()
    xy_px[chosen] += OFF_PX * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wrong = replace(frames[index], points=replace(points, xy_px=xy_px))
    return [*frames[:index], wrong, *frames[index + 1 :]], points.track_id[chosen]


def rows_of(result, track_id):
    return np.flatnonzero(np.isin(result.tracks.track_id, track_id))


def test_a_displaced_observation_belongs_to_nothing_and_its_track_to_the_scene_again_afterwards():
    frames, track_id = displaced(FRAMES, DISPLACED_FRAME)
    results = results_of(frames)
    wrong, after = results[DISPLACED_FRAME].tracks, results[DISPLACED_FRAME + 1].tracks
    rows = rows_of(results[DISPLACED_FRAME], track_id)
    is_out = wrong.cluster_id[rows] == NO_CLUSTER
    # A neighbour that is off alike by chance makes two of them look like a thing.
    assert np.mean(is_out) > 0.8
    assert set(wrong.status[rows[is_out]].tolist()) == {int(Status.not_rigid)}
    assert np.isnan(wrong.times.ttc_z_s[rows[is_out]]).all()
    others = np.setdiff1d(np.arange(len(wrong.track_id)), rows)
    assert np.mean(wrong.cluster_id[others] == SCENE_CLUSTER) > 0.97
    assert np.mean(after.cluster_id[rows_of(results[DISPLACED_FRAME + 1], track_id)] == SCENE_CLUSTER) > 0.95


def test_a_displaced_observation_leaves_the_times_of_its_track_as_they_were():
    frames, track_id = displaced(FRAMES, DISPLACED_FRAME)
    with_it, without = (results_of(some)[DISPLACED_FRAME + 1] for some in (frames, FRAMES))
    track_id = np.intersect1d(track_id, np.intersect1d(with_it.tracks.track_id, without.tracks.track_id))
    eta_hz = [1.0 / result.tracks.times.ttc_z_s[rows_of(result, track_id)] for result in (with_it, without)]
    assert np.mean(np.isfinite(eta_hz[0])) >= np.mean(np.isfinite(eta_hz[1])) - 0.05
    assert np.nanquantile(np.abs(eta_hz[0] / eta_hz[1] - 1.0), 0.9) < 0.05


def test_a_track_that_has_found_another_thing_begins_anew_there():
    """Not one view is wrong, but all that follow: the track has jumped over to another point of the scene."""
    track = FRAMES[0].points.track_id[np.isin(FRAMES[0].points.track_id, FRAMES[-1].points.track_id)][0]
    moved = []
    for frame in FRAMES:
        xy_px = frame.points.xy_px.copy()
        if frame.index >= 12:
            xy_px[frame.points.track_id == track] += (0.0, 10.0)
        moved.append(replace(frame, points=replace(frame.points, xy_px=xy_px)))
    results = results_of(moved)
    ids = [int(result.tracks.cluster_id[rows_of(result, [track])[0]]) for result in results]
    assert ids[11] == SCENE_CLUSTER
    assert ids[12:14] == [NO_CLUSTER, NO_CLUSTER]
    assert ids[-1] == SCENE_CLUSTER


def test_most_of_many_displaced_observations_among_noisy_ones_belong_to_nothing():
    """A fifth of all, up to 12 px off, at 1 px of noise: the more are found, the less it takes to be one."""
    rng, frames, is_out, settled = np.random.default_rng(3), [], {}, 10
    for frame in table([street()], driving(10.0), 22, sigma_px=1.0):
        chosen = rng.random(len(frame.points.track_id)) < 0.2
        xy_px = frame.points.xy_px + np.where(chosen[:, None], rng.uniform(-12.0, 12.0, frame.points.xy_px.shape), 0.0)
        is_out[frame.index] = dict(zip(frame.points.track_id.tolist(), chosen.tolist(), strict=True))
        frames.append(replace(frame, points=replace(frame.points, xy_px=xy_px)))
    taken_in, left_out = [], []
    for result in results_of(frames)[settled:]:
        tracks = result.tracks
        is_wrong = np.array([is_out[result.frame][number] for number in tracks.track_id.tolist()])
        old = tracks.n_frames >= settled
        taken_in.append(tracks.cluster_id[is_wrong & old] != NO_CLUSTER)
        left_out.append(tracks.cluster_id[~is_wrong & old] == NO_CLUSTER)
    assert np.mean(np.concatenate(taken_in)) < 0.5
    assert np.mean(np.concatenate(left_out)) < 0.03
