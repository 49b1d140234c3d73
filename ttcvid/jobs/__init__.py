"""Wiring of sources, pipeline and sinks."""
