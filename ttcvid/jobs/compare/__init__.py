"""The command `compare`: two results held against each other."""
