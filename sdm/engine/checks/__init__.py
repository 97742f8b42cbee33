"""Checks of maps and distances that are probably not what was meant: one warning at most for each caller."""
