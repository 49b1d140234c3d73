"""Egomotion: rotation and direction of travel of the camera."""
