"""Finished runs: what is in their folders, and what their manifests say."""
