"""Drawings of the documentation's explanations: `python -m sdm.bench.drawings`."""
