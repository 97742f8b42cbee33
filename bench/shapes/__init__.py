"""Benchmarks of shape models: python -m sdm.bench.shapes.atria."""
