"""Warp kernels for exact signed distances to triangle meshes.

Nothing here knows torch or `sdm`: the functions take and fill `wp.array`s that the caller owns, and launch on
Warp's current stream. Read in this order: `geometry` (one triangle), `tree` (the bounding volume hierarchy),
`closest` (the nearest triangle), `crossings` (integer winding numbers), `boundary` (what open meshes add),
`solid_angle` (any soup), `points` and `dense` (the queries).
"""
