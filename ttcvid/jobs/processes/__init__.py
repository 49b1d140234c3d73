"""Processes, threads, memory and compiled code."""
