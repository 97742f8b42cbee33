"""Maps of meshes that differ on grids of any shape: one build and one pass over the columns for all meshes of a chunk.

The stages of the dense query run once for the meshes whose plans have the cells in common, which decide about the last
bit of a value. What a map is does not depend on the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
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
    LAYER,
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
from sdm.runtime.torch_warp import as_warp, on_current_stream, to_device, workspace

# Most times the shares of another of a group that a map's lists are made in: for the other they are idle work.
MOST_SHARES = 2


@dataclass(frozen=True)
class MapJob:
    """A mesh, on its device, and the grid of its map."""

    number: int  # of the mesh in the whole list
    mesh: TriangleMesh
    grid: Grid
    given: TriangleMesh | None = None  # the mesh where it was before, if that is elsewhere

    @cached_property
    def turned(self) -> bool:
        """True if the grid's axes are not x, y and z."""
        return self.grid.direction != IDENTITY

    @cached_property
    def work(self) -> Workload:
        """Workload of the map by itself."""
        count = len(self.mesh)
        return Workload(count, depth_for(count), 1, self.grid.shape, self.grid.spacing, self.turned)

    @cached_property
    def plan(self) -> Plan:
        """The plan of the map by itself."""
        return make_plan(self.work, memory_of(wp.device_from_torch(self.mesh.device).alias), OPTIONS.get())


class JointMaps(NamedTuple):
    """Maps (nx,ny,nz) of some meshes, how many voxels of each are ambiguous, and the meshes' structures.

    None in place of the map of a mesh with many copies of a triangle, which is left to its own call.
    """

    maps: list[tuple[Tensor, int] | None]
    structure: RaggedStructure


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
    build.leave_out([plan.levels_left_out for plan in plans])
    device = build.memory[0].device
    starts = np.concatenate([[0], np.cumsum([voxels_of(job.grid.shape) for job in jobs])]).tolist()
    # Without a sign, those of points outside.
    values = (torch.empty if signed else torch.zeros)(starts[-1], dtype=torch.float32, device=device)
    ambiguous = torch.zeros(len(jobs), dtype=torch.int32, device=device)
    thick = _with_thick_slices(jobs, build.view)
    groups = _groups(jobs, plans, set(range(len(jobs))) - thick)
    rows = to_device(torch.from_numpy(_slab_rows(jobs, plans, starts, groups)), device)
    empty, surface = workspace(device), build.view
    with on_current_stream(values, values, rows, *build.memory):
        whole = as_warp(values, wp.float32)
        # Whole numbers, which are those of closed meshes.
        if signed:
            slab_winding(surface.tree, surface.winding, _slab(jobs, rows[0]), whole, empty, options.most_columns)
    structure = build.finish([job.number for job in jobs])
    maps = [
        values[start : start + math.prod(job.grid.shape)].view(job.grid.shape)
        for start, job in zip(starts, jobs, strict=False)
    ]
    crowded = {i for i, topology in structure.topologies.items() if may_be_crowded(jobs[i].mesh, topology.boundary)}
    if crowded:
        thick -= crowded
        groups = _groups(jobs, plans, set(range(len(jobs))) - thick - crowded)
        rows = to_device(torch.from_numpy(_slab_rows(jobs, plans, starts, groups)), device)
    with on_current_stream(values, values, rows, *build.memory):
        for i in structure.topologies.keys() - thick - crowded if signed else ():
            _fill_open(structure.of_mesh(i), jobs[i].grid, maps[i])
        target = Target(whole, as_warp(ambiguous, wp.int32), None)
        parts = [(_slab(jobs, table), plan) for table, (_, plan) in zip(rows, groups, strict=False)]
        tree, _, frames, features, cones = surface
        query_slabs(Surface(tree, frames, features, cones), target, parts, empty, partial(kernels_beside, values))
    for i in thick:
        own, unclear = structure_slab(structure.of_mesh(i), jobs[i].grid, 0, maps[i].shape[0], signed=signed)
        maps[i], ambiguous[i] = own[0], unclear[0]
    # Of closed meshes it is known without a look at the device, which would wait for it.
    counts = ambiguous.tolist() if structure.topologies and signed else [0] * len(jobs)
    found = [(values, counts[i] if i in structure.topologies else 0) for i, values in enumerate(maps)]
    return JointMaps([None if i in crowded else pair for i, pair in enumerate(found)], structure)


def _with_thick_slices(jobs: Sequence[MapJob], view: KernelView) -> set[int]:
    """The maps that are measured on finer grids, each by itself (`sdm.engine.thick_slices`)."""
    if jobs[0].mesh.device.type != "cpu":
        return set()
    factors = OPTIONS.get().slice_factors
    scales = scales_of(view.tree, len(jobs))
    return {
        i
        for i, (job, scale) in enumerate(zip(jobs, scales, strict=True))
        if finer(Slices(job.grid.spacing, job.grid.shape, 0), scale, len(job.mesh), factors) != AS_IT_IS
    }


def _groups(jobs: Sequence[MapJob], plans: Sequence[Plan], together: set[int]) -> list[tuple[list[int], Plan]]:
    """The maps whose plans agree in cells, and nearly in shares, and one plan for each such group."""
    groups: list[list[int]] = []
    first = None
    for i in sorted(together, key=lambda i: (plans[i].cell, plans[i].cell_shares, plans[i].region_shares)):
        if (
            first is None
            or plans[i].cell != first.cell
            or plans[i].cell_shares > MOST_SHARES * first.cell_shares
            or plans[i].region_shares > MOST_SHARES * first.region_shares
        ):
            first = plans[i]
            groups.append([])
        groups[-1].append(i)
    memory = memory_of(wp.device_from_torch(jobs[0].mesh.device).alias)
    return [
        (group, joint_plan([jobs[i].work for i in group], [plans[i] for i in group], memory, OPTIONS.get()))
        for group in groups
    ]


def _slab_rows(
    jobs: Sequence[MapJob], plans: Sequence[Plan], starts: Sequence[int], groups: Sequence[tuple[list[int], Plan]]
) -> np.ndarray:
    """Rows of the slabs (groups, meshes, SLAB_ROW) float64: in each group's the other meshes have no regions."""
    # One at least: all slabs in the count of voxels.
    rows = np.zeros((max(1, len(groups)), len(jobs), SLAB_ROW))
    for i, job in enumerate(jobs):
        grid, row = job.grid, rows[:, i]
        row[:, ORIGIN : ORIGIN + 3] = grid.origin
        row[:, SPACING : SPACING + 3] = grid.spacing
        row[:, SHAPE : SHAPE + 3] = grid.shape
        row[:, LAYER], row[:, VOXEL] = 0, starts[i]
        row[:, REGION_SHARES], row[:, CELL_SHARES] = plans[i].region_shares, plans[i].cell_shares
        if job.turned:
            row[:, AXES : AXES + 9] = [
                d * s for line in grid.direction for d, s in zip(line, grid.spacing, strict=True)
            ]
    for (group, _plan), table in zip(groups, rows, strict=False):
        regions = np.zeros(len(jobs))
        regions[group] = [plans[i].total for i in group]
        table[1:, REGION] = np.cumsum(regions)[:-1]
    return rows


def _slab(jobs: Sequence[MapJob], rows: Tensor) -> Any:
    """All slabs, as kernels take them."""
    slab = Slab()
    slab.turned = int(jobs[0].turned)
    slab.shape = wp.vec3i(*(max(job.grid.shape[axis] for job in jobs) for axis in range(3)))
    slab.meshes = len(jobs)
    set_array(slab, "rows", as_warp(rows.view(-1), wp.float64))
    return slab


def _fill_open(structure: AccelerationStructure, grid: Grid, values: Tensor) -> None:
    """Queue the kernels that put the winding numbers of an open mesh in the place of whole ones."""
    view, empty = structure.view, workspace(values.device)
    slab = slab_view(grid.origin, grid.spacing, grid.shape, 0, tuple(x for row in grid.direction for x in row))
    slab_winding(view.tree, view.winding, slab, as_warp(values[None], wp.float32), empty, OPTIONS.get().most_columns)
