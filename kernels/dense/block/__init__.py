"""Measurement of one block, inside stage 6: its voxels and the features of triangles near it, in shared memory."""
