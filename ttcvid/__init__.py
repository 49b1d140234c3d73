"""Collision times, directions of motion and miss distances from one camera."""
