"""Shared by the benchmarks: meshes, the float64 oracle, timing, records, tables."""
