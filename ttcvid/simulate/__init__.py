"""Scenes with exact truth: what a camera sees, and what is true of it.

This is the public interface; everything below it may change.
"""

from ttcvid.simulate.encounters import Encounter, encounters, encounters_in
from ttcvid.simulate.loading import load_scene
from ttcvid.simulate.object_truth import ObjectTruth
from ttcvid.simulate.render import Rendered, Renderer, render_frames
from ttcvid.simulate.scene import Scene, camera_of
from ttcvid.simulate.tracks import SimulatedTracks, TrackOptions, simulate_tracks, tracks_of
from ttcvid.simulate.truth import TrueTimes, true_times
from ttcvid.simulate.world import SKY_LABEL, STATIC_LABEL, World, build_world

__all__ = [
    "SKY_LABEL",
    "STATIC_LABEL",
    "Encounter",
    "ObjectTruth",
    "Rendered",
    "Renderer",
    "Scene",
    "SimulatedTracks",
    "TrackOptions",
    "TrueTimes",
    "World",
    "build_world",
    "camera_of",
    "encounters",
    "encounters_in",
    "load_scene",
    "render_frames",
    "simulate_tracks",
    "tracks_of",
    "true_times",
]
