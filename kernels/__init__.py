"""Warp kernels for exact signed distances to triangle meshes.

Nothing here knows torch or `sdm`: the functions take and fill `wp.array`s that the caller owns, and launch on Warp's
current stream. Read in this order: `lanes`, `atomics`, `wide` and `records` (what CPU and GPU do differently),
`launch` (launches), `grid` (a slab of voxels), `geometry` (one triangle), `curve`, `tree` and `build` (the hierarchy
of boxes), `edges` (which faces meet), `seams` (which edges bound a mesh), `closest` (the nearest triangle),
`crossings` (integer winding numbers), `boundary`, `caps` and `holes` (what open meshes add), `solid_angle` (any
soup), `winding` (the choice), `columns`, `scan` and `search` (the plain dense query), `frames`, `rough`, `cull`,
`cones` and `parts` (what can be dropped), `lists`, `places`, `stacks`, `witness`, `regions`, `cells`, `plan`,
`queues`, `leaves`, `selection`, `rows`, `octants`, `features`, `mix`, `boxes`, `least`, `voxels`, `blocks` and
`sliced` (the fast one), `effort` and `dense` (the choice between them), `descent`, `together`, `gather`, `board`,
`shortlist`, `groups`, `nearest_points`, `point_signs` and `points` (scattered points, both ways), `samples` (where
DeepSDF has its), `edt_near`, `edt_rows`, `edt_lines`, `edt_along` and `edt` (the distance transform of volumes),
`volume` (NanoVDB), and `shapes_random`, `shapes_rotation`, `shapes_solids`, `shapes_warped` and `shapes_cochlea`
(parameters and vertices of families).
"""

import os
import sys
import tempfile

import warp as wp

# Warp greets, and reports every module that it compiles; a library should not. Whoever set a level keeps it.
if wp.config.log_level == wp.LOG_INFO:
    wp.config.log_level = wp.LOG_ERROR


def _start_warp() -> None:
    """Start Warp without its warning that a machine has no NVIDIA driver, which its native code writes on its own.

    Anything else that it writes meanwhile is passed on.
    """
    with tempfile.TemporaryFile() as log:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(log.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            log.seek(0)
            lines = [line for line in log if b"find or load the NVIDIA CUDA driver" not in line]
            if lines:
                os.write(2, b"".join(lines))


_start_warp()
