"""Orientation of closed meshes: outward or inside out."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float64, Integer

from sdm.core.mesh import TriangleMesh

# Solid angles that the search for inside-out components may cost.
MOST_SOLID_ANGLES = 20_000_000
# A signed volume below this share of what it is the sum of is rounding: the mesh encloses nothing.
VOLUME_ROUNDING = 1e-12
CHUNK = 1 << 18


def orient_outward(mesh: TriangleMesh) -> TriangleMesh:
    """Turn an inside-out mesh: every face, if the mesh is closed and its signed volume is negative.

    Nothing else is ever touched, so that cavities stay cavities: an open mesh, one whose volume is positive, and one
    that encloses nothing come back as they are, as the same object. A mesh in which only some components are inside
    out is named by `inspect_mesh`, and is the user's to mend.

    Args:
        mesh: Any mesh, on any device; nothing is copied to the host but one number.
    """
    # `sdm inspect` needs nothing of Warp, whose start takes a third of a second.
    from sdm.topology.boundary_edges import boundary_edges

    if boundary_edges(mesh.vertices, mesh.faces).shape[0] > 0:
        return mesh
    corners = mesh.vertices.detach()[mesh.faces.long()].double()
    # Volumes about a point near the mesh lose no digits to a far origin.
    corners = corners - corners[:1, :1]
    volumes = (corners[:, 0] * torch.linalg.cross(corners[:, 1], corners[:, 2])).sum(1)
    return mesh.flipped() if bool(volumes.sum() < -VOLUME_ROUNDING * volumes.abs().sum()) else mesh


def inside_out(
    corners: Float64[np.ndarray, "F 3 3"],
    component: Integer[np.ndarray, " F"],
    volume: Float64[np.ndarray, " C"],
    closed: Bool[np.ndarray, " C"],
) -> tuple[int, int]:
    """Count the closed components that face inward without being a cavity of the others.

    Args:
        corners: (F,3,3) float64.
        component: (F,) component of each face, -1 for none.
        volume: (C,) signed volume of each component, 0 for those that enclose nothing.
        closed: (C,) whether each is closed.

    Returns:
        How many are inside out, and how many could not be judged because it would take too long. A component that
        faces inward is a cavity, and right, where the winding number of the others is above 0.5.
    """
    suspects = np.flatnonzero(closed & (volume < 0))
    if len(suspects) == 0:
        return 0, 0
    order = np.argsort(component, kind="stable")
    begin = np.searchsorted(component[order], np.arange(len(volume)))
    end = np.searchsorted(component[order], np.arange(len(volume)), side="right")
    first = np.searchsorted(component[order], 0)
    low = np.minimum.reduceat(corners[order[first:]].min(1), begin - first)
    high = np.maximum.reduceat(corners[order[first:]].max(1), begin - first)
    size = end - begin

    wrong = cost = 0
    for position, suspect in enumerate(suspects):
        point = corners[order[begin[suspect]], 0]
        # Outside its own box a closed component has winding number zero.
        near = ~closed | ((low <= point) & (point <= high)).all(1)
        near[suspect] = False
        cost += int(size[near].sum())
        if cost > MOST_SOLID_ANGLES:
            return wrong, len(suspects) - position
        winding = sum(_winding(point, corners[order[begin[c] : end[c]]]) for c in np.flatnonzero(near))
        wrong += winding < 0.5
    return wrong, 0


def _winding(point: np.ndarray, corners: np.ndarray) -> float:
    """Winding number of triangles (F,3,3) about a point (3,), by solid angles (van Oosterom and Strackee 1983)."""
    total = 0.0
    for begin in range(0, len(corners), CHUNK):
        a, b, c = np.moveaxis(corners[begin : begin + CHUNK] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        volume = (a * np.cross(b, c)).sum(1)
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total += float(np.arctan2(volume, below).sum())
    return total / (2 * np.pi)
