"""Warp kernels for exact signed distances to triangle meshes.

Nothing here knows torch or `sdm`: the functions take and fill `wp.array`s that the caller owns, and launch on Warp's
current stream. Folders know only those below them, so read them from the bottom up:

- `primitives` and `launch`: lanes, atomics, vector loads and stores, shared memory, queues; launches.
- `geometry`, `topology`: one triangle, a slab of voxels, boxes of voxels; pairs of faces, boundary loops.
- `bvh`: the hierarchy of boxes, and the plain search for the nearest triangle.
- `winding`: winding numbers, by crossings of rays, scan conversion, and the boundary of open meshes.
- `culling`: what can be dropped, by witnesses, cones of normals, and features of triangles.
- `closest`: closest points, and the face that is named where several are equally near.
- `dense`: distances at every voxel. First `voxel_search`, the plain path; then `plan`, which decides, and `query`,
  which runs the stages `stage1_witnesses` to `stage7_merge`.
- `band`: distances at the voxels of blocks near the surface alone, by the stages of `dense`.
- `points`: distances at scattered points. First `query`, the plain path and the fast one.
- `flood`: signs for meshes whose faces say none, by what a ball reaches from outside.
- `edt`: the distance transform of volumes. `surface`: surfaces of maps. `shapes`: parameters, vertices and samples of
  families. `nanovdb`: volumes. `text`: numbers in mesh files.
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
