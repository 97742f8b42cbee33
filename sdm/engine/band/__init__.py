"""Narrow bands of meshes: the voxels near the surface alone, in blocks."""
