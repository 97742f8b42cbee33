"""Surfaces of maps: marching cubes and dual contouring, of dense maps and of blocks of 8^3 voxels."""
