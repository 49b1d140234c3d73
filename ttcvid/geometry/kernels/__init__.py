"""Compiled building blocks of the estimators: residuals, normal equations, solvers and loops, each of them once."""
