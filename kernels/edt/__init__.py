"""Exact Euclidean distance transform of label volumes, separable, one pass for each axis."""
