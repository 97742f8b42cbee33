"""Signs by a flood from outside (`sdm.kernels.flood`), for meshes whose faces do not say what is inside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.maps import LARGEST_SLAB
from sdm.engine.ops import structure_slab
from sdm.errors import GridError
from sdm.inspect.agreement import agreeing_turns
from sdm.inspect.positions import first_at_position
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import small_caps

# A flood's grid holds the whole mesh. It may have so many times the voxels of the map, or so many in any case.
MOST_TIMES, ALWAYS = 8, 1 << 24
# Roundings of float32 by which distances and places may be off.
ROUNDINGS = 16
# One voxel in so many may climb; where more do, all voxels are gone through, which takes longer.
LISTED = 16
# Voxels by which the mesh's box is taken for larger than it is.
MARGIN = 1e-3


@dataclass(frozen=True)
class Frame:
    """A grid that holds a mesh with a layer of voxels beyond its box on every side.

    Args:
        grid: The grid.
        skipped: Layers along each axis before those of the map.
        low: The first voxel of the mesh's box along each axis.
        high: The last one.
        size: The largest coordinate.
    """

    grid: Grid
    skipped: tuple[int, int, int]
    low: tuple[int, int, int]
    high: tuple[int, int, int]
    size: float

    def as_struct(self, radius: float) -> Any:
        """The grid as kernels take it."""
        # Here and below: maps by winding numbers do not wait for these kernels to be imported.
        from sdm.kernels.flood.flood_grid import FloodGrid

        found, spacing = FloodGrid(), self.grid.spacing
        found.shape = wp.vec3i(*self.grid.shape)
        found.spacing = wp.vec3d(*spacing)
        found.origin = wp.vec3d(*self.grid.origin)
        found.axes = wp.mat33d(*self.grid.affine[:3, :3].reshape(-1).tolist())
        found.low, found.high = wp.vec3i(*self.low), wp.vec3i(*self.high)
        found.radius = wp.float64(radius)
        found.deep = wp.float64(radius + 2 * math.hypot(*spacing))
        found.slack = wp.float64(ROUNDINGS * self.size * 2.0**-24)
        return found


def flooded(
    distances: Tensor,
    hole_size: float,
    *,
    grid: Grid,
    structure: AccelerationStructure,
    mesh: TriangleMesh,
    rims: Tensor,
    closed: bool,
) -> Tensor:
    """Distances with the sign of a flood, see `negate_inside`; the gradients of those inside are turned round too."""
    values = distances.detach().clone()
    negate_inside(values, grid, structure, mesh.vertices.detach(), mesh.faces, rims, closed, hole_size)
    return torch.where(values < 0, -distances, distances) if distances.requires_grad else values


def negate_inside(
    values: Tensor,
    grid: Grid,
    structure: AccelerationStructure,
    vertices: Tensor,
    faces: Tensor,
    rims: Tensor,
    closed: bool,
    hole_size: float,
) -> None:
    """Give distances the sign of a flood: negate, in place, those of voxels inside.

    Args:
        values: (nx,ny,nz) float32, unsigned distances on the grid.
        grid: Where.
        structure: Of the mesh.
        vertices: (V,3), of the mesh.
        faces: (F,3).
        rims: (E,2) edges of its holes, see `rims_of`.
        closed: Whether its winding numbers are whole numbers.
        hole_size: Gaps that are narrower than this length let nothing through.

    Raises:
        GridError: The mesh reaches so far beyond the grid that a grid which holds it would be too large.

    Takes 4 bytes a voxel, and for a mesh with small holes 4 more. Looks at the mesh's box, which waits for the device.
    """
    from sdm.kernels.flood.flood_signs import flood_signs
    from sdm.kernels.flood.off_grid_climb import Walls
    from sdm.kernels.flood.uphill_links import StuckVoxels

    frame = frame_of(grid, vertices, faces)
    distances = values
    if frame.grid is not grid:
        distances = _unsigned(structure, frame.grid)
    near = distances
    caps = small_caps(rims, vertices, hole_size)
    closing = structure
    if caps.shape[0]:
        closing = build(vertices[None], caps, caps.new_empty((0, 2)))
        near = torch.minimum(distances, _unsigned(closing, frame.grid))
    links = torch.empty(frame.grid.size, dtype=torch.int32, device=values.device)
    listed = torch.empty(frame.grid.size // LISTED + 2, dtype=torch.int32, device=values.device)
    numbers, count = listed.split([len(listed) - 1, 1])
    walls, stuck = Walls(), StuckVoxels()
    walls.with_caps, walls.closed = int(caps.shape[0] > 0), int(closed)
    reads = (*structure.memory, *closing.memory, distances, near, links, listed)
    with on_current_stream(values, values, *reads):
        stuck.numbers, stuck.count = as_warp(numbers, wp.int32), as_warp(count, wp.int32)
        walls.tree, walls.caps = structure.view.tree, closing.view.tree
        flood_signs(
            walls,
            frame.as_struct(hole_size / 2),
            as_warp(distances.reshape(-1), wp.float32),
            as_warp(near.reshape(-1), wp.float32),
            as_warp(links, wp.int32),
            stuck,
            as_warp(values.reshape(-1), wp.float32),
            grid.shape,
            frame.skipped,
        )


def rims_of(mesh: TriangleMesh, edges: Tensor | None) -> Tensor:
    """Edges (E,2) of a mesh's holes, whichever way its faces face, given its boundary `edges` (E,2) if they are known.

    Where faces disagree, the edges between them are left over twice: then faces are made to agree first. Of very many
    copies of a face one is to be given: a walk along the rims of all looks at each for each.
    """
    if edges is None:
        edges = boundary_edges(mesh.vertices, mesh.faces)
    # They are sorted.
    if not bool((edges[1:] == edges[:-1]).all(1).any()):
        return edges
    vertices, faces = mesh.numpy()
    merged = first_at_position(vertices)[faces.astype(np.int64)]
    turn, _, _ = agreeing_turns(merged, np.ones(len(faces)))
    agreed = torch.from_numpy(np.where(turn[:, None], merged[:, ::-1], merged).astype(np.int32))
    return boundary_edges(mesh.vertices.detach(), agreed.to(mesh.device))


def _unsigned(structure: AccelerationStructure, grid: Grid) -> Tensor:
    return structure_slab(structure, grid, 0, grid.shape[0], signed=False)[0][0]


def frame_of(grid: Grid, vertices: Tensor, faces: Tensor, *, limited: bool = True) -> Frame:
    """The grid of a flood: the map's, with further layers where the mesh's box comes to its border or beyond.

    `limited` refuses one that is too large for a dense flood.
    """
    low, high, size = _box_of(grid, vertices, faces)
    last = np.asarray(grid.shape) - 1
    low, high = low - MARGIN, high + MARGIN
    before = np.maximum(0, np.floor(-low) + 1)
    after = np.maximum(0, np.floor(high - last) + 1)
    shape = before + last + 1 + after
    voxels = float(np.prod(shape))
    if limited and (voxels > LARGEST_SLAB or voxels > max(MOST_TIMES * grid.size, ALWAYS)):
        raise GridError(
            f"a flood comes from outside, so its grid has to hold the mesh, which takes {voxels:.3g} voxels here: "
            "use a grid around the mesh, or sign='winding'"
        )
    skipped = (int(before[0]), int(before[1]), int(before[2]))
    if before.any() or after.any():
        origin = np.asarray(grid.origin) - grid.affine[:3, :3] @ before
        grid = Grid(origin, grid.spacing, shape, grid.direction)
    corner = np.abs(np.asarray(grid.origin)) + np.abs(grid.affine[:3, :3]) @ np.asarray(grid.shape)
    first, end = np.ceil(low + before), np.floor(high + before)
    return Frame(grid, skipped, _ints(first), _ints(end), max(size, float(corner.max())))


def _ints(values: np.ndarray) -> tuple[int, int, int]:
    return int(values[0]), int(values[1]), int(values[2])


def _box_of(grid: Grid, vertices: Tensor, faces: Tensor) -> tuple[np.ndarray, np.ndarray, float]:
    """The least and the largest indices (3,) of the mesh's vertices in a grid, and their largest coordinate."""
    inverse = np.linalg.inv(grid.affine[:3, :3])
    used = vertices.detach()[faces.reshape(-1).long()]
    away = [used[:, k].double() - grid.origin[k] for k in range(3)]
    # No product of matrices: a process's first one loads cuBLAS, a sixth of a second.
    at = torch.stack([away[0] * row[0] + away[1] * row[1] + away[2] * row[2] for row in inverse.tolist()], 1)
    found = torch.cat([at.amin(0), at.amax(0), used.abs().amax().double()[None]]).cpu().numpy()
    return found[:3], found[3:6], float(found[6])
