"""Meshes that differ, in one call: chunks of them are built together, and their maps made together."""
