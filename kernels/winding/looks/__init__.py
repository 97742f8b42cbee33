"""Second looks at boxes of voxels in doubt, on a GPU: with small tolerances, by caps and nodes that are near a box."""
