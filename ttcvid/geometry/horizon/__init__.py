"""The horizon as a line, and what tells it."""
