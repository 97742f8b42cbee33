"""Closest points: the face that is named where several are equally near, and the closest points of a map's voxels."""
