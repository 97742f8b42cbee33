"""Maps of meshes that differ on grids of any shape: one build and one pass over the columns for all meshes of a chunk.

The stages of the dense query run once for the meshes whose plans have the cells in common, which decide about the last
bit of a value. What a map is does not depend on the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import IDENTITY, Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure, KernelView
from sdm.engine.ops import slab_view, structure_slab
from sdm.engine.plan_override import OPTIONS
from sdm.engine.ragged.chunks import voxels_of
from sdm.engine.ragged.structure import RaggedBuild, RaggedStructure
from sdm.engine.repeated_faces import may_be_crowded
from sdm.engine.thick_slices import AS_IT_IS, Slices, finer, scales_of
from sdm.kernels.bvh.tree import depth_for
from sdm.kernels.dense.plan import Plan, Workload, joint_plan, make_plan, memory_of
from sdm.kernels.dense.query import Surface, Target, query_slabs
from sdm.kernels.geometry.voxel_grid import (
    AXES,
    CELL_SHARES,
    ORIGIN,
    REGION,
    REGION_SHARES,
    SHAPE,
    SLAB_ROW,
    SPACING,
    VOXEL,
    Slab,
)
from sdm.kernels.launch import set_array
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.graphs.branches import kernels_beside
from sdm.runtime.torch_warp import as_warp, on_current_stream, to_device, warp_name, workspace

# Most times the shares of another of a group that a map's lists are made in: for the other they are idle work.
MOST_SHARES = 2


class MapJob:
    """A mesh, on its device, and the grid of its map.

    Args:
        number: Of the mesh in the whole list.
        mesh: The mesh.
        grid: The grid.
        given: The mesh where it was before, if that is elsewhere.
    """

    __slots__ = ("_plan", "given", "grid", "mesh", "number", "triangles", "turned", "voxels")

    def __init__(self, number: int, mesh: TriangleMesh, grid: Grid, given: TriangleMesh | None = None) -> None:
        self.number, self.mesh, self.grid = number, mesh, grid
        self.given = mesh if given is None else given
        self.triangles, self.voxels = mesh.faces.shape[0], voxels_of(grid.shape)
        # True if the grid's axes are not x, y and z.
        self.turned = grid.direction != IDENTITY
        self._plan: tuple[Workload, Plan] | None = None

    @property
    def plan(self) -> tuple[Workload, Plan]:
        """The workload of the map by itself, and the plan of that."""
        if self._plan is None:
            grid, count = self.grid, self.triangles
            work = Workload(count, depth_for(count), 1, grid.shape, grid.spacing, self.turned)
            self._plan = work, make_plan(work, memory_of(warp_name(self.mesh.vertices.device)), OPTIONS.get())
        return self._plan


class JointMaps(NamedTuple):
    """Maps of some meshes: parts of one tensor, save some that were made by themselves.

    Args:
        whole: The tensor.
        jobs: What was asked.
        starts: Of each map its first place in the tensor.
        alone: The maps (nx,ny,nz) that were made by themselves, by the meshes' places.
        left: Places of meshes with many copies of a triangle, which are left to calls of their own.
        counts: Of each map how many voxels are ambiguous.
        structure: The meshes' structures.
    """

    whole: Tensor
    jobs: Sequence[MapJob]
    starts: Sequence[int]
    alone: dict[int, Tensor]
    left: set[int]
    counts: Sequence[int]
    structure: RaggedStructure

    def values(self, place: int) -> Tensor:
        """A map (nx,ny,nz)."""
        own = self.alone.get(place)
        if own is not None:
            return own
        shape, start = self.jobs[place].grid.shape, self.starts[place]
        return self.whole[start : start + math.prod(shape)].view(shape)


def ragged_maps(jobs: Sequence[MapJob], *, signed: bool = True) -> JointMaps:
    """The maps of meshes on one device.

    Args:
        jobs: Their plans are for cells. Either all grids are turned, or none is.
        signed: By winding numbers; else all values are distances of at least 0.

    Raises:
        MeshError: A face index out of range.
    """
    # The device is at work on the build while the host plans what comes after.
    build, options = RaggedBuild([job.mesh for job in jobs]), OPTIONS.get()
    plans = [job.plan for job in jobs]
    device = build.memory[0].device
    starts = [0, *accumulate([job.voxels for job in jobs])]
    # Without a sign, those of points outside.
    whole = (torch.empty if signed else torch.zeros)(starts[-1], dtype=torch.float32, device=device)
    ambiguous = torch.zeros(len(jobs), dtype=torch.int32, device=device)
    thick = _with_thick_slices(jobs, build.view)
    groups = _groups(plans, [i for i in range(len(jobs)) if i not in thick], device)
    rows, levels = _to_device(_slab_rows(jobs, plans, starts, groups), plans, device)
    build.leave_out(levels)
    empty, surface = workspace(device), build.view
    largest = wp.vec3i(*(max(axis) for axis in zip(*[job.grid.shape for job in jobs], strict=True)))
    slab = partial(_slab, jobs, largest)
    with on_current_stream(whole, whole, rows, *build.memory):
        values = as_warp(whole, wp.float32)
        # Whole numbers, which are those of closed meshes.
        if signed:
            slab_winding(surface.tree, surface.winding, slab(rows[0]), values, empty, options.most_columns)
    structure = build.finish([job.number for job in jobs], remember=True)
    crowded = {i for i in structure.kinds if may_be_crowded(jobs[i].mesh, structure.edges_of(i))}
    found = JointMaps(whole, jobs, starts, {}, crowded, [0] * len(jobs), structure)
    if crowded:
        thick -= crowded
        groups = _groups(plans, [i for i in range(len(jobs)) if i not in thick and i not in crowded], device)
        rows, _ = _to_device(_slab_rows(jobs, plans, starts, groups), plans, device)
    with on_current_stream(whole, whole, rows, *build.memory):
        for i in structure.kinds.keys() - thick - crowded if signed else ():
            _fill_open(structure.of_mesh(i, for_maps=True), jobs[i].grid, found.values(i))
        target = Target(values, as_warp(ambiguous, wp.int32), None)
        parts = [(slab(table), plan) for table, (_, plan) in zip(rows, groups, strict=False)]
        tree, _, frames, features, cones = surface
        query_slabs(Surface(tree, frames, features, cones), target, parts, empty, partial(kernels_beside, whole))
    for i in thick:
        grid = jobs[i].grid
        own, unclear = structure_slab(structure.of_mesh(i, for_maps=True), grid, 0, grid.shape[0], signed=signed)
        found.alone[i], ambiguous[i] = own[0], unclear[0]
    if not (structure.kinds and signed):
        # Of closed meshes it is known without a look at the device, which would wait for it.
        return found
    counts = ambiguous.tolist()
    return found._replace(counts=[counts[i] if i in structure.kinds else 0 for i in range(len(jobs))])


def _with_thick_slices(jobs: Sequence[MapJob], view: KernelView) -> set[int]:
    """The maps that are measured on finer grids, each by itself (`sdm.engine.thick_slices`)."""
    if jobs[0].mesh.device.type != "cpu":
        return set()
    factors = OPTIONS.get().slice_factors
    scales = scales_of(view.tree, len(jobs))
    return {
        i
        for i, (job, scale) in enumerate(zip(jobs, scales, strict=True))
        if finer(Slices(job.grid.spacing, job.grid.shape, 0), scale, job.triangles, factors) != AS_IT_IS
    }


def _groups(
    plans: Sequence[tuple[Workload, Plan]], together: list[int], device: torch.device
) -> list[tuple[list[int], Plan]]:
    """The maps whose plans agree in cells, and nearly in shares, and one plan for each such group."""
    groups: list[list[int]] = []
    first = None
    keys = [(plan.cell, plan.cell_shares, plan.region_shares) for _, plan in plans]
    for i in sorted(together, key=keys.__getitem__):
        plan = plans[i][1]
        if (
            first is None
            or plan.cell != first.cell
            or plan.cell_shares > MOST_SHARES * first.cell_shares
            or plan.region_shares > MOST_SHARES * first.region_shares
        ):
            first = plan
            groups.append([])
        groups[-1].append(i)
    memory, options = memory_of(warp_name(device)), OPTIONS.get()
    return [
        (group, joint_plan([plans[i][0] for i in group], [plans[i][1] for i in group], memory, options))
        for group in groups
    ]


def _slab_rows(
    jobs: Sequence[MapJob],
    plans: Sequence[tuple[Workload, Plan]],
    starts: Sequence[int],
    groups: Sequence[tuple[list[int], Plan]],
) -> np.ndarray:
    """Rows of the slabs (groups, meshes, SLAB_ROW) float64: in each group's the other meshes have no regions."""
    own = np.zeros((len(jobs), SLAB_ROW))
    grids = [job.grid for job in jobs]
    own[:, ORIGIN : ORIGIN + 3] = [grid.origin for grid in grids]
    own[:, SPACING : SPACING + 3] = [grid.spacing for grid in grids]
    own[:, SHAPE : SHAPE + 3] = [grid.shape for grid in grids]
    own[:, VOXEL] = starts[: len(jobs)]
    own[:, REGION_SHARES] = [plan.region_shares for _, plan in plans]
    own[:, CELL_SHARES] = [plan.cell_shares for _, plan in plans]
    if jobs[0].turned:
        axes = np.array([grid.direction for grid in grids]) * own[:, None, SPACING : SPACING + 3]
        own[:, AXES : AXES + 9] = axes.reshape(-1, 9)
    # One at least: all slabs in the count of voxels.
    rows = np.repeat(own[None], max(1, len(groups)), axis=0)
    for (group, _plan), table in zip(groups, rows, strict=False):
        regions = np.zeros(len(jobs))
        regions[group] = [plans[i][1].total for i in group]
        table[1:, REGION] = np.cumsum(regions)[:-1]
    return rows


def _to_device(
    rows: np.ndarray, plans: Sequence[tuple[Workload, Plan]], device: torch.device
) -> tuple[Tensor, Tensor | None]:
    """The rows on a device, and by one copy how many levels each mesh's lists do without; None if none does."""
    levels = [plan.levels_left_out for _, plan in plans]
    if not any(levels):
        return to_device(torch.from_numpy(rows), device), None
    both = to_device(torch.from_numpy(np.concatenate([rows.reshape(-1), levels])), device)
    return both[: rows.size].view(rows.shape), both[rows.size :]


def _slab(jobs: Sequence[MapJob], largest: wp.vec3i, rows: Tensor) -> Any:
    """All slabs, as kernels take them; `largest` is the longest shape along each axis."""
    slab = Slab()
    slab.turned, slab.shape, slab.meshes = int(jobs[0].turned), largest, len(jobs)
    set_array(slab, "rows", as_warp(rows.view(-1), wp.float64))
    return slab


def _fill_open(structure: AccelerationStructure, grid: Grid, values: Tensor) -> None:
    """Queue the kernels that put the winding numbers of an open mesh in the place of whole ones."""
    view, empty = structure.view, workspace(values.device)
    slab = slab_view(grid.origin, grid.spacing, grid.shape, 0, tuple(x for row in grid.direction for x in row))
    slab_winding(view.tree, view.winding, slab, as_warp(values[None], wp.float32), empty, OPTIONS.get().most_columns)
