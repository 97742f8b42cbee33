"""The inside of stage 6: one block of voxels and the features of triangles near it, in shared memory."""
