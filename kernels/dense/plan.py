"""Plan of a dense query: all decisions of the cost model about one slab, made once and before any device work."""
# pyright: basic

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import warp as wp

from sdm.kernels.dense.chunk_pool import CHUNK
from sdm.kernels.dense.cost_model import (
    ALL_COARSE,
    FINE,
    MOST_REGIONS,
    NO_SPLITS,
    blocks_for,
    cell_for,
    expected_entries,
    has_brick_lists,
    is_measured_together,
    levels_left_out,
    list_split_for,
    passes_for,
    pool_for,
    search_is_faster,
    shares_and_parts,
    shares_of,
    split_length_for,
    uneven_room,
    without_idle_splits,
)
from sdm.kernels.dense.region_grid import BLOCK
from sdm.kernels.plan_options import PlanOptions


class Workload(NamedTuple):
    """Counts and sizes that a plan follows from.

    Args:
        triangles: Of each mesh.
        depth: The tree of each mesh has 2^depth leaves.
        meshes: Of the batch.
        shape: Voxels (n,ny,nz) of the slab.
        spacing: Of the grid, (x,y,z), in the mesh's unit.
        turned: True if the grid's axes are not x, y and z.
    """

    triangles: int
    depth: int
    meshes: int
    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    turned: bool


@dataclass(frozen=True)
class Plan:
    """Decisions about the query of one slab. Maps of a batch, and slabs of a grid, are planned alike.

    Args:
        method: `"cells"` for the seven stages, `"search"` for one search a voxel.
        cell: Voxels along the edge of a cell: 4, 8 or 16.
        regions: Regions of 2^3 cells along each axis of the slab.
        total: Regions of all meshes.
        passes: Passes over the regions, each of which takes one of so many.
        most: Regions of the largest pass.
        region_shares: Groups of lanes that make the candidate list of a region: a power of two.
        cell_shares: The same for a cell: as many, or a power of two less.
        levels_left_out: Last levels of the tree that candidate lists do without.
        block_shares: Groups of lanes that make the list of features of a block.
        block_parts: Groups of lanes that measure a block where winners are wanted, some of its octants each.
        together: Without winners all groups of a thread block measure each block, see `block.together`.
        split_length: Leaves of a cell's candidate list that one group of lanes takes.
        chunks: Chunks of the pool of candidate lists.
        by_brick: True if bricks of cells of 16^3 voxels have lists of their own, see `bricks.select_bricks`.
        list_split: Leaves of a cell's candidate list that one group of lanes makes these lists of.
        blocks: Blocks that there is room for in each class of lengths: every split but the last of a list is full.
        most_columns: See `PlanOptions`.
        list_bricks_below: Coarse bricks of maps that are shorter along each axis are searched by lists: 0 for none.
    """

    method: str
    cell: int
    regions: tuple[int, int, int]
    total: int
    passes: int
    most: int
    region_shares: int
    cell_shares: int
    levels_left_out: int
    block_shares: int
    block_parts: int
    together: bool
    split_length: int
    by_brick: bool
    list_split: int
    chunks: int
    blocks: int
    most_columns: int | None
    list_bricks_below: int


@lru_cache(maxsize=16)
def memory_of(device: str) -> int | None:
    """Bytes of a GPU's memory; None of a CPU's, which no plan depends on."""
    found = wp.get_device(device)
    return int(found.total_memory) if found.is_cuda else None


class Decisions(NamedTuple):
    """Decisions of a plan that the bits of a value depend on; see `Plan`."""

    method: str
    cell: int
    region_shares: int
    cell_shares: int
    levels_left_out: int


@lru_cache(maxsize=256)
def decide(work: Workload, gpu: bool, options: PlanOptions) -> Decisions:
    """The decisions of `make_plan` about a query on a GPU, or on a CPU, that decide about bits."""
    shape, method = work.shape, options.method
    if method == "auto":
        method = "search" if search_is_faster(work.triangles, shape, gpu) else "cells"
    cell = options.cell or cell_for(work.triangles, shape, gpu)
    left_out = options.levels_left_out
    if left_out is None:
        left_out = levels_left_out(work.triangles, work.depth, shape)
    region_shares, cell_shares = options.shares or (shares_of(work.triangles, shape, cell) if gpu else (1, 1))
    return Decisions(method, cell, region_shares, cell_shares, min(left_out, work.depth))


def is_by_brick(work: Workload, cell: int, gpu: bool, options: PlanOptions) -> bool:
    """True if bricks of cells of so many voxels along an edge have lists of their own: no bits depend on it."""
    if options.by_brick is not None:
        return options.by_brick and cell > int(BLOCK)
    return has_brick_lists(work.triangles, work.shape, cell, gpu)


def lists_of(regions: int, by_brick: bool) -> int:
    """Lists of cells, or of their bricks, in so many regions."""
    return (64 if by_brick else 8) * regions


@lru_cache(maxsize=256)
def make_plan(work: Workload, memory: int | None, options: PlanOptions) -> Plan:
    """The plan of a query on a GPU with so many bytes of memory, or on a CPU if that is None.

    Remembered, as the cost model takes the host as long as some launches.
    """
    gpu, shape = memory is not None, work.shape
    method, cell, region_shares, cell_shares, left_out = decide(work, gpu, options)
    nx, ny, nz = (-(-n // (2 * cell)) for n in shape)
    total = work.meshes * nx * ny * nz
    depth = work.depth - left_out
    by_brick = is_by_brick(work, cell, gpu, options)
    split_length = split_length_for(work.triangles, depth, lists_of(total, by_brick)) if gpu else NO_SPLITS
    split_length = options.split_length or without_idle_splits(split_length, depth)
    expected = expected_entries(work.triangles, shape, cell, region_shares, cell_shares, by_brick)
    expected *= uneven_room(work.spacing, work.turned)
    entries = options.pool_entries or pool_for(expected, total, memory)
    passes = passes_for(expected, total, entries, min(options.most_regions or MOST_REGIONS, MOST_REGIONS))
    most = -(-total // passes)
    chunks = entries // CHUNK
    by_option = ALL_COARSE if options.list_bricks else 0
    # A coarse cell of 16^3 voxels has bricks that may be too coarse, on a grid of any size.
    by_model = (ALL_COARSE if by_brick else FINE) if gpu else 0
    below = by_model if options.list_bricks is None else by_option
    block_shares, block_parts = shares_and_parts(work.triangles, shape, total, cell) if gpu else (1, 1)
    together = gpu and is_measured_together(total, cell)
    together = together if options.block_parts is None else options.block_parts > 1
    return Plan(
        method=method,
        cell=cell,
        regions=(nx, ny, nz),
        total=total,
        passes=passes,
        most=most,
        region_shares=region_shares,
        cell_shares=cell_shares,
        levels_left_out=left_out,
        block_shares=1 if by_brick else options.block_shares or block_shares,
        block_parts=options.block_parts or block_parts,
        together=together and not by_brick,
        split_length=split_length,
        by_brick=by_brick,
        list_split=options.list_split or list_split_for(8 * total),
        chunks=chunks,
        blocks=blocks_for(most, chunks, split_length, by_brick),
        most_columns=options.most_columns,
        list_bricks_below=below if max(shape) < below else 0,
    )


def joint_plan(works: Sequence[Workload], plans: Sequence[Plan], memory: int | None, options: PlanOptions) -> Plan:
    """One plan for meshes that differ, whose own plans agree in cells, so that all values stay the same.

    Their shares are theirs; there is room for as many as the one with most has.

    Args:
        works: Of each mesh alone.
        plans: The plan of each.
        memory: See `make_plan`.
        options: Those of the plans.
    """
    expected, by_brick = 0.0, any(plan.by_brick for plan in plans)
    region_shares, cell_shares = max(plan.region_shares for plan in plans), max(plan.cell_shares for plan in plans)
    for work, plan in zip(works, plans, strict=True):
        entries = expected_entries(work.triangles, work.shape, plan.cell, region_shares, cell_shares, by_brick)
        expected += plan.total * entries * uneven_room(work.spacing, work.turned)
    total = sum(plan.total for plan in plans)
    split_length = NO_SPLITS
    if memory is not None:
        depths = [work.depth - plan.levels_left_out for work, plan in zip(works, plans, strict=True)]
        split_length = min(
            split_length_for(work.triangles, depth, lists_of(total, by_brick))
            for work, depth in zip(works, depths, strict=True)
        )
        split_length = without_idle_splits(split_length, max(depths))
    split_length = options.split_length or split_length
    entries = options.pool_entries or pool_for(expected / total, total, memory)
    passes = passes_for(expected / total, total, entries, min(options.most_regions or MOST_REGIONS, MOST_REGIONS))
    most, chunks = -(-total // passes), entries // CHUNK
    groups, together = [(1, 1)], False
    if memory is not None:
        together = is_measured_together(total, plans[0].cell)
        groups = [shares_and_parts(work.triangles, work.shape, total, plans[0].cell) for work in works]
    together = together if options.block_parts is None else options.block_parts > 1
    block_shares, block_parts = min(groups)
    return replace(
        plans[0],
        regions=(0, 0, 0),
        region_shares=region_shares,
        cell_shares=cell_shares,
        total=total,
        passes=passes,
        most=most,
        levels_left_out=max(plan.levels_left_out for plan in plans),
        block_shares=1 if by_brick else options.block_shares or block_shares,
        block_parts=options.block_parts or block_parts,
        together=together and not by_brick,
        split_length=split_length,
        by_brick=by_brick,
        list_split=options.list_split or list_split_for(8 * total),
        chunks=chunks,
        blocks=blocks_for(most, chunks, split_length, by_brick),
        # Of each map by itself, as alone: see `coarse_bricks`.
        list_bricks_below=max(plan.list_bricks_below for plan in plans),
    )
