"""Bounding volume hierarchy: tree, build on the device, triangle frames, nearest-triangle search."""
