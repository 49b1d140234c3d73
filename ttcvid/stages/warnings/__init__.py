"""Collision course, and the warnings that follow from it."""
