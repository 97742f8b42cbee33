"""Benchmarks and the accuracy report, installed as `sdm.bench`; a checkout has their records in `bench/results`."""
