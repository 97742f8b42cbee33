"""Dirty meshes that need no files."""
