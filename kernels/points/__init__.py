"""Signed distances of scattered points: groups of 32 neighbours, or one search for each."""
