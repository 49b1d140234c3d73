"""The evidence of the road against static tracks: movers along our own direction.

Such a mover looks like a static object at another depth, which would lie under the road or hang over it
(`stages.segmentation.ground_contact`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.ground_contact import Contacts, OnGround, find_contacts
from ttcvid.stages.segmentation.road import KNOWN_PART, LEAST_BELOW, LEAST_VIEWS, Road, RoadPoints, find_road
from ttcvid.stages.tracking.groups import places_among

# Evidence decays by the first factor per frame, by the second while an object is not observed against the road (it has
# no texture).
_FORGETTING, _NOTHING_SAID = 0.8, 0.97


@dataclass(frozen=True)
class RoadMemory:
    """Road of a frame, and evidence of tracks against it.

    track_id, evidence : ``(N,)`` evidence of each track against being static, in 0 to 1, by its ground contact.
    by_speed : ``(N,)`` evidence by a change of its speed (`stages.segmentation.speed_changes`).
    road : the road as from `find_road`; None: not found.
    seen : what it was fitted to.
    """

    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    evidence: Floats = field(default_factory=lambda: np.empty(0))
    by_speed: Floats = field(default_factory=lambda: np.empty(0))
    road: Road | None = None
    seen: RoadPoints = field(default_factory=RoadPoints)


def gathered_evidence(
    memory: RoadMemory, track_id: Ints, views: BodyViews, fit: PathFit, key: Ints, in_scene: Bools, aim: Floats
) -> RoadMemory:
    """The memory with the road and the evidence of this frame.

    ``fit`` of all N tracks on the trajectory of the scene, ``key (N,)`` their bodies, ``in_scene (N,)`` those that may
    be points of the road; ``aim (2,)`` our direction of travel in the plane z = 1.
    """
    place = places_among(memory.track_id, track_id)
    is_known = place >= 0
    # `place` -1, of a new track, picks the last one.
    evidence = np.append(memory.evidence, 0.0)[place]
    by_speed = _FORGETTING * np.append(memory.by_speed, 0.0)[place]
    now_s = float(views.t_s[-1])
    seen = memory.seen.and_now(RoadPoints.of(fit, in_scene, aim, track_id, now_s), now_s)
    road = find_road(seen, aim)
    if road is None:
        return RoadMemory(track_id, _FORGETTING * evidence, by_speed, None, seen)
    nearest_hz = np.maximum(fit.rate_hz, np.maximum(road.rate_hz(fit.place), LEAST_BELOW * road.slope_hz))
    has_depth = fit.rate_sigma_hz < KNOWN_PART * nearest_hz
    is_rated = views.is_free & (fit.n_views >= LEAST_VIEWS) & has_depth
    ground = OnGround(fit.place, fit.rate_hz, fit.rate_sigma_hz, road, is_rated, float(aim[0]))
    contacts = find_contacts(views.xy_px, views.link_px, ground, key)
    evidence = _shared_evidence(evidence, is_known & (fit.n_views > LEAST_VIEWS), contacts)
    # A track that lies under the road by itself needs no others, and no frames before.
    evidence[ground.is_under & ~contacts.is_own] = 1.0
    return RoadMemory(track_id, evidence, by_speed, road, seen)


def _shared_evidence(evidence: Floats, is_old: Bools, contacts: Contacts) -> Floats:
    """Evidence ``(N,)``, equal over each object: mean of its older tracks, updated by its ground contact now."""
    own, new = np.flatnonzero(contacts.thing >= 0), _FORGETTING * evidence
    thing, n_things = contacts.thing[own], len(contacts.contradicts)
    count = np.bincount(thing, is_old[own], n_things)
    mean = np.bincount(thing, is_old[own] * evidence[own], n_things) / np.maximum(count, 1.0)
    says = contacts.contradicts | contacts.is_borne
    mean = np.where(says, _FORGETTING * mean + (1.0 - _FORGETTING) * contacts.contradicts, _NOTHING_SAID * mean)
    new[own] = mean[thing]
    return new
