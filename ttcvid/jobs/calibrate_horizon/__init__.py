"""The command `calibrate-horizon`."""
