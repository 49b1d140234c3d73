"""A result held against a truth."""
