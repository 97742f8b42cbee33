"""Figures, and a window with a map."""
