"""NanoVDB volumes of narrow bands: leaves for the blocks, tiles for what is not stored, inside and outside.

Warp allocates the tree, and knows neither which voxels are active nor tiles: these are written here into the volume's
own bytes, which are laid out as NanoVDB's `NanoVDB.h` (version 32) says, on whatever device they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from jaxtyping import Float32, Int32, UInt8
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, joined_runs
from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM

# Where the tree begins; in it, the offsets of leaves, lower and upper nodes and the root, their counts, active voxels.
TREE, COUNTS, ACTIVE = 672, 32, 56
# Bytes of a leaf, and where its mask of active voxels is, and its values; bytes of a lower and an upper node.
LEAF, LEAF_MASK, LEAF_VALUES = 2144, 16, 96
LOWER, UPPER = 33856, 270400
# Of both, where the mask of children is, and the table; entries along an edge, and blocks along the edge of an entry.
LEVELS = ((544, 1088, 16, 1), (4128, 8256, 32, 16))


@dataclass(frozen=True)
class Nodes:
    """The parts of a volume, as views of its bytes.

    Args:
        bytes: (B,) all of it.
        leaves: (N, LEAF) each.
        lower: (M, LOWER) nodes of 16^3 blocks.
        upper: (U, UPPER) nodes of 32^3 lower ones.
    """

    bytes: UInt8[Tensor, " b"]
    leaves: UInt8[Tensor, "n leaf"]
    lower: UInt8[Tensor, "m lower"]
    upper: UInt8[Tensor, "u upper"]

    @property
    def blocks(self) -> Int32[Tensor, "n 3"]:
        """Block of each leaf."""
        return self.leaves[:, :12].contiguous().view(torch.int32) >> 3

    @property
    def values(self) -> Float32[Tensor, "n 8 8 8"]:
        """Values of each leaf, a copy."""
        return self.leaves[:, LEAF_VALUES:].contiguous().view(torch.float32).reshape(-1, *3 * [BLOCK])


def nodes_of(volume: wp.Volume) -> Nodes:
    """The parts of a volume of float values."""
    array: Any = volume.array()
    # On a CPU Warp's own way would go by torch's default device.
    data = torch.from_numpy(array.numpy()) if array.device.is_cpu else wp.to_torch(array)
    data = data.view(torch.uint8)
    offsets = data[TREE : TREE + 32].clone().view(torch.int64).tolist()
    counts = data[TREE + COUNTS : TREE + COUNTS + 12].clone().view(torch.int32).tolist()
    sizes = LEAF, LOWER, UPPER
    parts = [
        data[TREE + at : TREE + at + count * size].view(count, size)
        for at, count, size in zip(offsets, counts, sizes, strict=False)
    ]
    return Nodes(data, *parts)


def volume_of(band: SparseSDM) -> wp.Volume:
    """The volume of a band, on its device: a level set whose active voxels are those of the band.

    Raises:
        RuntimeError: Warp cannot make it.
    """
    grid, device = band.grid, wp.device_from_torch(band.device)
    # There is no volume without a leaf.
    blocks = band.blocks if len(band.blocks) else band.blocks.new_zeros((1, 3))
    tiles = (blocks * BLOCK).contiguous()
    volume = wp.Volume.allocate_by_tiles(
        wp.from_torch(tiles, dtype=wp.vec3i),
        bg_value=band.width,
        translation=grid.origin,
        transform=wp.mat33f(*grid.affine[:3, :3].ravel().tolist()),
        device=device,
    )
    nodes = nodes_of(volume)
    _fill_leaves(nodes, band)
    if len(band.inside):
        _fill_tiles(nodes, band)
    return volume


def _fill_leaves(nodes: Nodes, band: SparseSDM) -> None:
    blocks = nodes.blocks
    place = band.find(blocks)
    values = band.background(blocks).float()[:, None].expand(-1, BLOCK**3)
    if len(band.blocks):
        # In Warp's order of leaves.
        values = torch.where(place[:, None] < 0, values, band.values.detach().float().reshape(-1, BLOCK**3)[place])
    values = values.contiguous()
    nodes.leaves[:, LEAF_VALUES:] = values.view(torch.uint8)
    active = values.abs() < band.width
    bits = torch.arange(8, dtype=torch.uint8, device=band.device)
    mask = (active.view(-1, 64, 8).to(torch.uint8) << bits).sum(-1, dtype=torch.uint8)
    nodes.leaves[:, LEAF_MASK : LEAF_MASK + 64] = mask
    nodes.bytes[TREE + ACTIVE : TREE + ACTIVE + 8] = active.sum(dtype=torch.int64)[None].view(torch.uint8)


def _fill_tiles(nodes: Nodes, band: SparseSDM) -> None:
    """Minus the width in entries of nodes that have no child and lie inside."""
    for node, (children, table, edge, size) in zip((nodes.lower, nodes.upper), LEVELS, strict=True):
        # A few at a time, as each has 4096 entries or more.
        for some in node.split(256):
            tiles = entries_of(some, edge, size)
            free = ~has_child(some, children, edge)
            inside = (band.background(tiles) < 0) & free
            entries = some[:, table:].view(len(some), edge**3, 8)
            minus = torch.tensor([-band.width], dtype=torch.float32, device=band.device).view(torch.uint8)
            number, entry = inside.nonzero(as_tuple=True)
            entries[number, entry, :4] = minus


def entries_of(node: UInt8[Tensor, "m size"], edge: int, size: int) -> Int32[Tensor, "m k 3"]:
    """The first block of each entry of nodes of `edge`^3 entries of `size`^3 blocks."""
    # The first voxel that is in use, from which the node's own first one follows.
    low = node[:, :12].contiguous().view(torch.int32) >> 3
    corner = torch.div(low, edge * size, rounding_mode="floor") * (edge * size)
    steps = torch.arange(0, edge * size, size, dtype=torch.int32, device=node.device)
    return corner[:, None] + torch.cartesian_prod(steps, steps, steps)


def has_child(node: UInt8[Tensor, "m size"], children: int, edge: int) -> Tensor:
    """True (M, edge^3) for entries that are nodes."""
    mask = node[:, children : children + edge**3 // 8]
    bits = torch.arange(8, dtype=torch.uint8, device=node.device)
    return ((mask[:, :, None] >> bits) & 1).bool().reshape(len(node), edge**3)


def inside_of(nodes: Nodes, grid: Grid) -> Int32[Tensor, "r 4"]:
    """Runs of blocks in tiles below zero, as `SparseSDM.inside` has them."""
    count = blocks_along(grid.shape)
    runs = []
    for node, (children, table, edge, size) in zip((nodes.lower, nodes.upper), LEVELS, strict=True):
        for some in node.split(256):
            entries = some[:, table:].contiguous().view(torch.float32).view(len(some), edge**3, 2)[..., 0]
            inside = (entries < 0) & ~has_child(some, children, edge)
            tiles = entries_of(some, edge, size)[inside]
            across = torch.cartesian_prod(*2 * [torch.arange(size, dtype=torch.int32, device=tiles.device)])
            first = tiles[:, None].repeat(1, size * size, 1)
            first[..., :2] += across.view(-1, 2)
            first = first.view(-1, 3)
            runs.append(torch.cat([first, first[:, 2:] + size], 1))
    found = torch.cat(runs)
    found[:, 3].clamp_(max=count[2])
    within = (found[:, 0] < count[0]) & (found[:, 1] < count[1]) & (found[:, 2] < found[:, 3])
    return joined_runs(found[within], count)
