"""Estimators by maximum likelihood: thin functions over the kernels, and the intervals of what they find."""
