"""Generalised winding numbers: integer ray crossings, scan conversion, boundary terms, hole caps, dipoles."""
