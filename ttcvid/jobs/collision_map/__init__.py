"""The command `collision-map`."""
