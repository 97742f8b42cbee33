"""Vertices of parametric shape families, counter-based random numbers, samples on surfaces."""
