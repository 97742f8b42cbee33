"""Distance transforms of label volumes: of one mask or of many classes, and the nearest voxels."""
