"""True distances, to compare with: a float64 brute force over all triangles, and rational arithmetic."""
