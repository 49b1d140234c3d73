"""The paper's tracker: AKAZE features matched from picture to picture and chained into tracks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ttcvid.config import TrackingConfig
from ttcvid.model import Floats, Ints, Picture, PointSet
from ttcvid.stages.tracking.hamming import nearest_descriptors

# Bytes of an AKAZE descriptor (486 bits).
_DESCRIPTOR_BYTES = 61
# Features over tracks: some of them match none of the picture before.
_FEATURES_PER_TRACK = 1.1


@dataclass(frozen=True)
class Features:
    """AKAZE features of one picture: ``xy_px (N, 2)`` and ``descriptors (N, 61)`` uint8, strongest first."""

    xy_px: Floats
    descriptors: Picture


@dataclass(frozen=True)
class AkazeMemory:
    """Features of the last picture and the track of each: ``track_id (N,)``."""

    features: Features
    track_id: Ints
    next_track_id: int

    @property
    def seen(self) -> PointSet:
        """All features of the picture as points, ascending in their track."""
        order = np.argsort(self.track_id, kind="stable")
        nothing = np.empty(0, dtype=np.int64)
        return PointSet(self.track_id[order], self.features.xy_px[order], unseen_id=nothing)


def detect_features(grey: Picture, allowed: Picture | None, config: TrackingConfig) -> Features:
    """The strongest AKAZE features where the mask allows them, enough for ``max_tracks`` that match.

    The slow step of this tracker, and independent from picture to picture: run it for several pictures side by side.
    """
    detector = cv2.AKAZE.create(threshold=config.akaze_threshold, nOctaveLayers=config.akaze_layers)
    keypoints, descriptors = detector.detectAndCompute(grey, allowed)
    if descriptors is None or not len(keypoints):
        return Features(np.empty((0, 2)), np.empty((0, _DESCRIPTOR_BYTES), dtype=np.uint8))
    response = np.array([keypoint.response for keypoint in keypoints])
    strongest = np.argsort(-response, kind="stable")[: round(_FEATURES_PER_TRACK * config.max_tracks)]
    xy_px = np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float64)
    return Features(xy_px[strongest], np.asarray(descriptors, dtype=np.uint8)[strongest])


def start_akaze(features: Features, next_track_id: int = 0) -> AkazeMemory:
    """Start a track at every feature of a first picture."""
    track_id = next_track_id + np.arange(len(features.xy_px), dtype=np.int64)
    return AkazeMemory(features, track_id, next_track_id + len(track_id))


def follow_akaze(memory: AkazeMemory, features: Features, config: TrackingConfig) -> tuple[AkazeMemory, float]:
    """Match the features of this picture to the tracks of the last one.

    Features without a match start new tracks. Returns also the share of the former ones that were matched (1 where
    there were none): low after a cut.
    """
    former, now = _matches(memory.features.descriptors, features.descriptors, config.akaze_ratio)
    is_new = np.isin(np.arange(len(features.xy_px)), now, invert=True)
    n_new = int(np.count_nonzero(is_new))
    track_id = np.empty(len(is_new), dtype=np.int64)
    track_id[now], track_id[is_new] = memory.track_id[former], memory.next_track_id + np.arange(n_new)
    survival = len(former) / len(memory.track_id) if len(memory.track_id) else 1.0
    return AkazeMemory(features, track_id, memory.next_track_id + n_new), survival


def _matches(one: Picture, other: Picture, ratio: float) -> tuple[Ints, Ints]:
    """Mutual nearest neighbours that pass the ratio test: indices into ``one`` and into ``other``."""
    if len(one) < 2 or len(other) < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    nearest, distance_bits, second_bits, nearest_back = nearest_descriptors(one, other)
    is_mutual = nearest_back[nearest] == np.arange(len(one))
    good = np.flatnonzero(is_mutual & (distance_bits < ratio * second_bits))
    return good, nearest[good]
