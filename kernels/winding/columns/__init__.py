"""Crossings of columns of voxels in a quarter of the memory: see `packed_crossings`."""
