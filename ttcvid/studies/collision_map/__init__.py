"""Which change of own velocity leads to a collision."""
