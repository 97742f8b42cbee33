"""Layers of a grid whose blocks near a surface are measured together, and how."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch

from sdm.core.block_lookup import blocks_along
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure
from sdm.engine.ops import slab_view
from sdm.engine.plan_override import OPTIONS
from sdm.engine.thick_slices import AS_IT_IS, Slices, Triple, finer, scales_of
from sdm.kernels.bvh.tree import depth_for
from sdm.kernels.dense.plan import Plan, Workload, make_plan, memory_of
from sdm.runtime.torch_warp import warp_name


@dataclass(frozen=True, eq=False)
class BandSlab:
    """Query of the blocks of some layers of a grid that are near one mesh.

    Args:
        structure: Of the mesh.
        whole: The grid.
        width: How far the band reaches, in the mesh's unit.
        layers: The first, a multiple of the edge of any region of voxels, and the one after the last.
        signed: False for distances of at least 0.
        mesh: The mesh, if it is to be found out whether it reaches beyond the grid.
        beyond: Whether triangles may be beyond the last of the layers along x.
    """

    structure: AccelerationStructure
    whole: Grid
    width: float
    layers: tuple[int, int]
    signed: bool
    mesh: TriangleMesh | None = None
    beyond: bool = False

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along each axis."""
        return (self.layers[1] - self.layers[0], *self.whole.shape[1:])

    @property
    def along(self) -> tuple[int, int, int]:
        """Blocks along each axis."""
        return blocks_along(self.shape)

    @cached_property
    def direction(self) -> tuple[float, ...]:
        """The grid's axes, row by row."""
        direction = self.whole.direction
        return (*direction[0], *direction[1], *direction[2])

    @cached_property
    def slab(self) -> Any:
        """The layers, as kernels take them."""
        return slab_view(self.whole.origin, self.whole.spacing, self.shape, self.layers[0], self.direction)

    @cached_property
    def times(self) -> Triple:
        """Factors by which a dense map of these layers is measured with more slices."""
        options = OPTIONS.get()
        if self.structure.device.type != "cpu" or options.method == "search":
            return AS_IT_IS
        (scale,) = scales_of(self.structure.view.tree, 1)
        slices = Slices(self.whole.spacing, self.shape, self.layers[0])
        return finer(slices, scale, self.structure.sizes.faces, options.slice_factors)

    @cached_property
    def shifts(self) -> tuple[int, int, int]:
        """The same, as powers of two."""
        x, y, z = self.times
        return x.bit_length() - 1, y.bit_length() - 1, z.bit_length() - 1

    @cached_property
    def measured(self) -> Slices:
        """The layers that are measured, with `times` as many slices."""
        wanted, times = Slices(self.whole.spacing, self.shape, self.layers[0]), self.times
        if times == AS_IT_IS:
            return wanted
        across = tuple(k * (n - 1) + 1 for k, n in zip(times[1:], wanted.shape[1:], strict=True))
        spacing = tuple(s / k for s, k in zip(wanted.spacing, times, strict=True))
        return Slices(spacing, (times[0] * wanted.shape[0], *across), times[0] * wanted.first)

    @cached_property
    def measured_slab(self) -> Any:
        """These, as kernels take them."""
        fine = self.measured
        return slab_view(self.whole.origin, fine.spacing, fine.shape, fine.first, self.direction)

    @cached_property
    def plan(self) -> Plan:
        """The plan of a dense query of the measured layers."""
        return plan_for(self.structure.sizes.faces, self.measured, self.whole, self.structure.device)


def plan_for(triangles: int, measured: Slices, grid: Grid, device: torch.device) -> Plan:
    """The plan of a dense query of the measured layers of a grid, for a mesh of so many triangles."""
    turned = not grid.is_axis_aligned
    work = Workload(triangles, depth_for(triangles), 1, measured.shape, measured.spacing, turned)
    return make_plan(work, memory_of(warp_name(device)), OPTIONS.get())
