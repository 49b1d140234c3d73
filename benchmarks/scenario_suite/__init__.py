"""Hundreds of scenes that nobody chose, in the terms of the trade: drawn by family and seed, analysed, kept."""
