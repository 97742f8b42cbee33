"""Benchmark of narrow bands."""
