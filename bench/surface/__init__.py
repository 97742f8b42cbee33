"""Benchmark of surfaces of maps."""
