"""What a regression suite expects, and how it is told."""
