"""How the errors of direction and time grow."""
