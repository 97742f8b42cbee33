"""Warp kernels for exact signed distances to triangle meshes.

Nothing here knows torch or `sdm`: the functions take and fill `wp.array`s that the caller owns, and launch on
Warp's current stream. Read in this order: `geometry` (one triangle), `tree` (the bounding volume hierarchy),
`closest` (the nearest triangle), `crossings` (integer winding numbers), `boundary` (what open meshes add),
`solid_angle` (any soup), `points` (scattered queries), `scan` and `search` (the plain dense query), `frames`, `cull`,
`cells` and `blocks` (the fast one), `dense` (which of them runs).
"""

import warp as wp

# Warp greets, and reports every module that it compiles; a library should not. Whoever set a level keeps it.
if wp.config.log_level == wp.LOG_INFO:
    wp.config.log_level = wp.LOG_ERROR
