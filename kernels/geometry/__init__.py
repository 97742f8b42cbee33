"""Distances to one triangle, the Hilbert curve, voxel grids and boxes of voxels."""
