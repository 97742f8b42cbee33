"""The distance transform against SciPy and CuPy."""
