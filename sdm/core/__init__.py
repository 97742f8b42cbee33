"""Meshes, grids, signed distance maps, devices and random numbers."""
