"""Signed distances of every voxel of a slab: seven stages in the order of their names, and the plain search."""
