"""Values of a map between its voxels."""
