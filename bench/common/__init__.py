"""What benchmarks share: meshes, the float64 oracle, timing, records, tables."""
