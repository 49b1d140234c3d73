"""The command `regress`: clips analysed again, and held against their baselines."""
