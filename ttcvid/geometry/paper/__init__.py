"""The equations of the paper, each a pure function."""
