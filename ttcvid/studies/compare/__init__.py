"""Two results, joined and held against each other."""
