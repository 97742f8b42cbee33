"""The boundary's share of winding numbers on grids: sums over boundary edges in float32, with a bound."""
