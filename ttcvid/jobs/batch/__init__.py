"""The command `batch`: many clips."""
