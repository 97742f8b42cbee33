"""Benchmarks and the accuracy report: run from a checkout, not part of the installed package."""
