"""Kernels that tests wait for."""
