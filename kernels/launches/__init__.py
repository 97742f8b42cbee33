"""Warp's arrays and launches at less cost for the host: descriptors packed at once, launches recorded and filled in."""
