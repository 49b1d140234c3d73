"""Objects: their nearest surfaces, states and times."""
