"""Tracking of points from picture to picture; the only stage that uses OpenCV."""
