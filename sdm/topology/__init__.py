"""Boundary edges of meshes, and vertices at equal positions that count as one."""
