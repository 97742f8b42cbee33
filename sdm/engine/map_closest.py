"""Maps with their closest points: the feature that each voxel's distance is from is noted while it is measured."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure, Sizes
from sdm.engine.maps import LARGEST_SLAB, is_recordable, slabs_of
from sdm.engine.ops import points_closest, slab_view, structure_slab
from sdm.engine.plan_override import OPTIONS
from sdm.engine.thick_slices import AS_IT_IS, Slices, finer, scales_of
from sdm.kernels.dense import query as dense
from sdm.kernels.dense.cost_model import NO_SPLITS
from sdm.kernels.dense.plan import Workload, make_plan, memory_of
from sdm.kernels.launch import set_array
from sdm.runtime import graphs
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import kernels_beside
from sdm.runtime.graphs.output_slot import current_slot
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.face_pairing import neighbours

# Bytes of a voxel: its value, and its closest point, face and barycentric coordinates.
VOXEL_BYTES = 4 + 12 + 4 + 12
# Devices on which values are compared with those of the map itself: on an H100 those of stage 6 with winners have other
# last bits in one voxel of a thousand (bench/decisions/0030-closest-points-of-maps.md).
COMPARED = {"cuda": True, "cpu": False}


class ClosestMap(NamedTuple):
    """A map and its closest points: `values` (nx,ny,nz), `ambiguous` (1,), `points`, `faces` and `barycentric`."""

    values: Tensor
    ambiguous: Tensor
    points: Tensor
    faces: Tensor
    barycentric: Tensor


def closest_map(
    mesh: TriangleMesh,
    structure: AccelerationStructure,
    grid: Grid,
    layers: tuple[int, int] | None = None,
    *,
    known: Tensor | None = None,
    around: Tensor | None = None,
) -> ClosestMap:
    """The map of a mesh whose structure is built, with closest points; no gradients.

    Args:
        mesh: The mesh.
        structure: Its structure.
        grid: Where.
        layers: The first of the grid's layers and one past the last; by default all.
        known: The values of the map itself, if they are there: then nobody looks at a sign, and none is ambiguous.
        around: The neighbours (F,4) of its faces, if they are there.
    """
    faces = mesh.faces.contiguous()
    inputs = faces, neighbours(faces, mesh.vertices.shape[0]) if around is None else around
    begin, end = layers or (0, grid.shape[0])
    # One whose arrays lie in one block, as that of a mesh by itself.
    alone = layers is None and known is None and len(structure.memory) == 1
    if alone and is_recordable(mesh.vertices, VOXEL_BYTES // 4 * grid.nbytes + structure.nbytes):
        key = "closest", structure.sizes, grid, OPTIONS.get()
        call = Call(key, partial(_queue_recordable, structure.sizes, grid), (*structure.memory, *inputs))
        found = ClosestMap(*graphs.run(call))
    else:
        found = _queue(structure, grid, *inputs, begin, end, signed=known is None)
    compared = COMPARED[structure.device.type]
    ambiguous = found.ambiguous
    # Thick slices have a map that is measured on a finer grid and rounded otherwise.
    if known is None and (compared or (structure.device.type == "cpu" and _is_refined(structure, grid))):
        slabs = [structure_slab(structure, grid, *some) for some in slabs_of(grid, LARGEST_SLAB, begin, end)]
        known = torch.cat([slab[0][0] for slab in slabs])
        ambiguous = torch.stack([slab[1].reshape(1) for slab in slabs]).sum(0, dtype=torch.int32)
    if known is None:
        return found
    if compared:
        _ask_again(found, known, mesh, structure, grid, begin)
    return found._replace(values=known, ambiguous=ambiguous)


def _ask_again(
    found: ClosestMap, values: Tensor, mesh: TriangleMesh, structure: AccelerationStructure, grid: Grid, begin: int
) -> None:
    """Ask about voxels that have other distances than the map's `values` as scattered points. Waits for them."""
    other = torch.nonzero(values.abs() != found.values.abs())
    if not len(other):
        return
    affine = torch.from_numpy(grid.affine).to(other.device)
    at = other.double() + torch.tensor([begin, 0, 0], dtype=torch.float64, device=other.device)
    at = (at @ affine[:3, :3].T + affine[:3, 3]).float()
    _, *hits = points_closest(mesh.vertices.detach(), mesh.faces, at, structure)
    i, j, k = other.unbind(1)
    for whole, part in zip(found[2:], hits, strict=True):
        whole[i, j, k] = part.to(whole.dtype)


def _is_refined(structure: AccelerationStructure, grid: Grid) -> bool:
    options, slices = OPTIONS.get(), Slices(grid.spacing, grid.shape, 0)
    if options.method == "search":
        return False
    scale = scales_of(structure.view.tree, 1)[0]
    return finer(slices, scale, structure.sizes.faces, options.slice_factors) != AS_IT_IS


def _queue_recordable(
    sizes: Sizes, grid: Grid, verify: Verify, block: Tensor, faces: Tensor, around: Tensor
) -> ClosestMap:
    structure = AccelerationStructure.in_block(sizes, block.device, block)
    return _queue(structure, grid, faces, around, 0, grid.shape[0])


def _queue(
    structure: AccelerationStructure,
    grid: Grid,
    faces: Tensor,
    around: Tensor,
    begin: int,
    end: int,
    *,
    signed: bool = True,
) -> ClosestMap:
    """The layers from `begin` to `end`; without a sign if nobody looks at it."""
    # Here and below: maps without closest points do not wait for these kernels to be imported.
    from sdm.kernels.closest.closest_voxels import Surroundings, look_around

    device, shape = structure.device, (end - begin, *grid.shape[1:])
    found = ClosestMap(
        torch.empty(shape, dtype=torch.float32, device=device),
        torch.zeros(1, dtype=torch.int32, device=device),
        torch.empty((*shape, 3), dtype=torch.float32, device=device),
        torch.empty(shape, dtype=torch.int32, device=device),
        torch.empty((*shape, 3), dtype=torch.float32, device=device),
    )
    with on_current_stream(faces, structure.memory[0], faces, around) as warp_device:
        memory = memory_of(warp_device.alias)
        rows = torch.empty_like(around)
        normals = torch.empty(4 * faces.shape[0], dtype=torch.float32, device=device)
        meeting: Any = Surroundings()
        set_array(meeting, "rows", as_warp(rows, wp.int32))
        set_array(meeting, "normals", as_warp(normals, wp.float32))
        look_around(structure.view.tree, as_warp(faces, wp.int32), as_warp(around, wp.int32), meeting)
        for first, last in slabs_of(grid, LARGEST_SLAB, begin, end):
            part = slice(first - begin, last - begin)
            some = ClosestMap(*(whole if whole is found.ambiguous else whole[part] for whole in found))
            _queue_slab(structure, grid, first, last, meeting, memory, some, signed)
    return found


def _queue_slab(
    structure: AccelerationStructure,
    grid: Grid,
    begin: int,
    end: int,
    meeting: Any,
    memory: int | None,
    found: ClosestMap,
    signed: bool,
) -> None:
    from sdm.kernels.closest.closest_voxels import name_voxels
    from sdm.kernels.closest.hits import Hits

    values = found.values
    tree, winding, frames, features, cones = structure.view
    direction = (*grid.direction[0], *grid.direction[1], *grid.direction[2])
    slab = slab_view(grid.origin, grid.spacing, (end - begin, *grid.shape[1:]), begin, direction)
    work = Workload(structure.sizes.faces, tree.depth, 1, values.shape, grid.spacing, bool(slab.turned))
    hits: Any = Hits()
    hits.wanted = 1
    set_array(hits, "points", as_warp(found.points.reshape(-1, 3), wp.vec3))
    set_array(hits, "faces", as_warp(found.faces.reshape(-1), wp.int32))
    set_array(hits, "barycentric", as_warp(found.barycentric.reshape(-1, 3), wp.vec3))
    slot = current_slot()
    searched = torch.zeros(1, dtype=torch.int32, device=values.device)
    plan = make_plan(work, memory, replace(OPTIONS.get(), split_length=NO_SPLITS))
    dense.query_slab(
        dense.Surface(tree, frames, features, cones),
        winding if signed else None,
        slab,
        dense.Target(
            as_warp(values[None], wp.float32),
            as_warp(found.ambiguous, wp.int32),
            None if slot is None else as_warp(slot.bind(values), wp.int64),
            hits.faces,
            as_warp(searched, wp.int32),
        ),
        plan,
        workspace(values.device),
        partial(kernels_beside, values),
    )
    name_voxels(tree, slab, meeting, hits, as_warp(searched, wp.int32))
