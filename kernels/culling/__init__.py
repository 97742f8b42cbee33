"""Tests that drop triangles which cannot be nearest to any voxel of a box, with their proofs."""
