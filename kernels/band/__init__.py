"""Narrow bands: distances and signs at the voxels of blocks near the surface, by the stages of the dense query."""
