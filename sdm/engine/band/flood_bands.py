"""Narrow bands whose sign is that of a flood from outside, without a flood through the grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp
from jaxtyping import Bool, Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, blocks_of, find_blocks, joined_runs, keys_of
from sdm.core.grid import Grid
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.band.band_slabs import measured_blocks
from sdm.engine.band.inside_runs import all_gaps, inner_parts, middle_voxels, runs_between
from sdm.engine.band.listed_blocks import block_table
from sdm.engine.flood import Frame, frame_of
from sdm.errors import GridError
from sdm.kernels.flood.block_flood import are_inside, flood_blocks, negate_in_blocks
from sdm.kernels.flood.flood_nodes import FloodBlocks
from sdm.kernels.flood.off_grid_climb import Walls
from sdm.kernels.flood.uphill_links import StuckVoxels
from sdm.kernels.launch import set_array
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.cap_triangles import small_caps

if TYPE_CHECKING:
    from sdm.engine.mesh_index import MeshIndex

# Of a flood, as its nodes are counted with 32 bits.
MOST_BLOCKS = (1 << 22) - 1
# For rounding.
SAFETY = 1e-4


@dataclass(frozen=True)
class Flooded:
    """A flood that came to its end, on the grid of a frame.

    Args:
        frame: The grid that the dense map's flood goes through: the band's, or one that holds the mesh.
        keys: (N,) of the blocks that it went through voxel by voxel, ascending.
        gaps: (R,4) runs of blocks along z that are not among them, sorted.
        nodes: Both, as kernels take them.
        links: (1 + 512 N + R,) of all nodes.
        memory: What kernels read.
    """

    frame: Frame
    keys: Int64[Tensor, " n"]
    gaps: Int32[Tensor, "r 4"]
    nodes: Any
    links: Int32[Tensor, " m"]
    memory: tuple[Any, ...]

    def negate(self, blocks: Int32[Tensor, "k 3"], values: Tensor, grid: Grid) -> None:
        """Negate, in place, the values (K,8,8,8) of voxels inside, of blocks of the band's grid."""
        count = blocks_along(grid.shape)
        table, kept = block_table(blocks, count, keys_of(blocks, count))
        with on_current_stream(values, values, *kept, *self.memory):
            flat = as_warp(values.view(-1), wp.float32)
            negate_in_blocks(self.nodes, as_warp(self.links, wp.int32), table, grid.shape, self.frame.skipped, flat)

    def inside(self, voxels: Int32[Tensor, "k 3"]) -> Bool[Tensor, " k"]:
        """True for voxels of the frame's grid that are inside."""
        found = torch.zeros(len(voxels), dtype=torch.int32, device=voxels.device)
        voxels = voxels.contiguous()
        with on_current_stream(found, found, voxels, *self.memory):
            links = as_warp(self.links, wp.int32)
            are_inside(self.nodes, links, as_warp(voxels, wp.vec3i), as_warp(found, wp.int32))
        return found.bool()


def flood_band(
    index: MeshIndex, grid: Grid, width: float, hole_size: float
) -> tuple[Int32[Tensor, "n 3"], Tensor, Int32[Tensor, "r 4"]]:
    """Blocks (N,3) with a voxel nearer than `width`, their clamped values, and the runs of others that are inside.

    The distances are those of a band without signs. Their sign is that of the map with `sign="flood"`: the flood goes
    through a band so wide that beyond it the ball moves freely, and through what is not stored run by run.

    Raises:
        GridError: It does not fit into memory, or there are very many blocks.
    """
    mesh = index._measured
    frame = frame_of(grid, mesh.vertices.detach(), mesh.faces, limited=False)
    flood = frame.as_struct(hole_size / 2)
    reach = (float(flood.deep) + math.hypot(*grid.spacing) + 4 * float(flood.slack)) * (1 + SAFETY)
    reach = max(float(np.float32(reach)), width)
    blocks, wide = measured_blocks(index._structure, frame.grid, reach, signed=False)[:2]
    found = _flooded(index, frame, flood, reach, blocks, wide, hole_size)
    if frame.grid is grid:
        near = (wide < width).flatten(1).any(1).nonzero()[:, 0]
        blocks, values = blocks[near].contiguous(), wide[near].clamp(max=width)
    else:
        blocks, values = measured_blocks(index._structure, grid, width, signed=False)[:2]
    if len(blocks):
        found.negate(blocks, values, grid)
    return blocks, values, _inside_runs(found, grid, blocks)


def _flooded(
    index: MeshIndex,
    frame: Frame,
    flood: Any,
    reach: float,
    blocks: Int32[Tensor, "n 3"],
    wide: Tensor,
    hole_size: float,
) -> Flooded:
    """The flood through blocks (N,3) whose unsigned distances (N,8,8,8) are cut at `reach`."""
    device, count = blocks.device, blocks_along(frame.grid.shape)
    mesh = index._measured
    caps = small_caps(index.rims, mesh.vertices.detach(), hole_size)
    closing: AccelerationStructure = index._structure
    keys, to_caps = keys_of(blocks, count), wide
    if caps.shape[0]:
        closing = build(mesh.vertices.detach()[None], caps, caps.new_empty((0, 2)))
        beside, their = measured_blocks(closing, frame.grid, reach, signed=False)[:2]
        mesh_keys, cap_keys = keys, keys_of(beside, count)
        keys = torch.unique(torch.cat([mesh_keys, cap_keys]))
        blocks = blocks_of(keys, count)
        # Beyond its band it is so far to either that it does not matter how far.
        wide, to_caps = _at_keys(keys, mesh_keys, wide, reach), _at_keys(keys, cap_keys, their, reach)
    if len(keys) > MOST_BLOCKS:
        raise GridError(
            f"a flood would go through {len(keys):,} blocks of a band, and {MOST_BLOCKS:,} are possible: choose larger "
            "voxels or a smaller hole_size, or sign='winding'"
        )
    gaps = runs_between(*all_gaps(keys, count), count)
    row = gaps[:, 0].long() * count[1] + gaps[:, 1]
    rows = torch.searchsorted(row, torch.arange(count[0] * count[1] + 1, device=device)).int()
    table, kept = block_table(blocks, count, keys)
    distances = _of_nodes(wide, len(gaps), reach)
    near = torch.minimum(distances, _of_nodes(to_caps, len(gaps), reach)) if caps.shape[0] else distances
    links = torch.empty(len(distances), dtype=torch.int32, device=device)
    listed = torch.empty(max(1, BLOCK**3 * len(keys)), dtype=torch.int32, device=device)
    counted = torch.zeros(1, dtype=torch.int32, device=device)
    nodes: Any = FloodBlocks()
    walls, stuck = Walls(), StuckVoxels()
    walls.with_caps, walls.closed = int(caps.shape[0] > 0), int(index.closed and index._repeated is None)
    memory = (*kept, gaps, rows, *index._structure.memory, *closing.memory, distances, near, listed, counted)
    with on_current_stream(links, links, *memory):
        nodes.table, nodes.along = table, wp.vec2i(*count[:2])
        nodes.first_gap = 1 + BLOCK**3 * len(keys)
        set_array(nodes, "gaps", as_warp(gaps, wp.vec4i))
        set_array(nodes, "rows", as_warp(rows, wp.int32))
        stuck.numbers, stuck.count = as_warp(listed, wp.int32), as_warp(counted, wp.int32)
        walls.tree, walls.caps = index._structure.view.tree, closing.view.tree
        flat = as_warp(distances, wp.float32), as_warp(near, wp.float32)
        flood_blocks(walls, nodes, flood, *flat, as_warp(links, wp.int32), stuck)
    return Flooded(frame, keys, gaps, nodes, links, (*kept, gaps, rows))


def _at_keys(keys: Int64[Tensor, " n"], some: Int64[Tensor, " m"], values: Tensor, beyond: float) -> Tensor:
    """Values of blocks of `some` keys at all keys, `beyond` where there are none."""
    made = torch.full((len(keys), *values.shape[1:]), beyond, dtype=values.dtype, device=values.device)
    made[torch.searchsorted(keys, some)] = values
    return made


def _of_nodes(values: Tensor, gaps: int, reach: float) -> Tensor:
    """Distances of all nodes; that of node 0 is not looked at."""
    parts = values.new_full((1,), reach), values.reshape(-1), values.new_full((gaps,), reach)
    return torch.cat(parts)


def _inside_runs(found: Flooded, grid: Grid, blocks: Int32[Tensor, "n 3"]) -> Int32[Tensor, "r 4"]:
    """Runs (R,4) of the blocks of a grid that are not stored and are inside: a voxel in the middle says it."""
    count = blocks_along(grid.shape)
    keys = keys_of(blocks, count)
    skipped = torch.tensor(found.frame.skipped, device=blocks.device)

    def are_inside(some: Int64[Tensor, " k"]) -> Bool[Tensor, " k"]:
        return found.inside((middle_voxels(some, grid) + skipped).int())

    if found.frame.grid is not grid:
        return runs_between(*inner_parts(are_inside, *all_gaps(keys, count)), count)
    # All of a gap has one side, and of the flood's own blocks each is asked.
    single = found.keys[find_blocks(keys, found.keys) < 0]
    begin = keys_of(found.gaps[:, :3], count)
    begin, end = torch.cat([begin, single]), torch.cat([begin + (found.gaps[:, 3] - found.gaps[:, 2]), single + 1])
    inside = are_inside(begin)
    return joined_runs(runs_between(begin[inside], end[inside], count), count)
