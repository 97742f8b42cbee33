"""Signed distances of scattered points: packets of 32 neighbours, or one search for each."""
