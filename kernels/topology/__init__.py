"""Pairs of faces that share an edge, and the boundary loops of what they leave open."""
