"""Stock Warp's query in kernels: what its documentation shows, with a miss told apart."""
# Warp's own compiler checks the types inside kernels, by rules that are not Python's.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false

from __future__ import annotations

import warp as wp


@wp.func
def _signed(mesh: wp.uint64, p: wp.vec3, reach: float) -> float:
    query = wp.mesh_query_point_sign_winding_number(mesh, p, reach)
    value = float(wp.nan)
    if query.result:
        value = query.sign * wp.length(p - wp.mesh_eval_position(mesh, query.face, query.u, query.v))
    return value


@wp.kernel(enable_backward=False)
def grid_kernel(mesh: wp.uint64, origin: wp.vec3, spacing: wp.vec3, reach: float, out: wp.array3d[float]):
    i, j, k = wp.tid()
    p = origin + wp.cw_mul(spacing, wp.vec3(float(i), float(j), float(k)))
    out[i, j, k] = _signed(mesh, p, reach)


@wp.kernel(enable_backward=False)
def points_kernel(mesh: wp.uint64, points: wp.array[wp.vec3], reach: float, out: wp.array[float]):
    n = wp.tid()
    out[n] = _signed(mesh, points[n], reach)


@wp.kernel(enable_backward=False)
def distance_kernel(mesh: wp.uint64, points: wp.array[wp.vec3], reach: float, out: wp.array[float]):
    n = wp.tid()
    p = points[n]
    query = wp.mesh_query_point_no_sign(mesh, p, reach)
    value = float(wp.nan)
    if query.result:
        value = wp.length(p - wp.mesh_eval_position(mesh, query.face, query.u, query.v))
    out[n] = value
