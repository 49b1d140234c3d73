"""Real clips without a collision: what is warned of for nothing, and what is found of who can be seen by eye."""
