"""Surrogates of the cochlea family: from four parameters to a signed distance map, without a mesh."""
