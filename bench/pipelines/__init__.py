"""Pipelines of training data with distance maps, ours beside SciPy's."""
