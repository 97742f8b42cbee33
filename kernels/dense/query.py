"""Dense query: signed distances at every voxel of a slab of a grid, for a batch of meshes."""
# pyright: basic, reportGeneralTypeIssues=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, TypeAlias

import warp as wp

from sdm.kernels.bvh.tree import Tree, coarser
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.bricks.select_bricks import BRICK_BLOCKS_PER_SM, select_bricks
from sdm.kernels.dense.coarse_bricks import SEARCH_BLOCKS_PER_SM, search_bricks
from sdm.kernels.dense.cost_model import NO_SPLITS
from sdm.kernels.dense.plan import Plan
from sdm.kernels.dense.stage1_witnesses import find_witnesses
from sdm.kernels.dense.stage2_regions import REGION_BLOCKS_PER_SM, list_regions
from sdm.kernels.dense.stage3_cells import CELL_BLOCKS_PER_SM, list_cells
from sdm.kernels.dense.stage4_blocks import SCHEDULE_BLOCKS_PER_SM, schedule_blocks
from sdm.kernels.dense.stage5_select import SELECT_BLOCKS_PER_SM, select_features
from sdm.kernels.dense.stage6_measure import measure_blocks, scratch_rows
from sdm.kernels.dense.stage7_merge import SPLIT_BLOCKS_PER_SM, begin_split, end_split
from sdm.kernels.dense.voxel_search import mend_slab, search_slab
from sdm.kernels.dense.workspace import Workspace, make_workspace
from sdm.kernels.geometry.voxel_grid import Output, Slab
from sdm.kernels.launch import set_array, threads
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_GROUPS, GPU_LANES, gpu_workers
from sdm.kernels.primitives.shared_stacks import STACK
from sdm.kernels.winding.column_sums import begin_crossings, slab_winding
from sdm.kernels.winding.winding_number import Winding

# Gives a context whose result makes what comes after it wait for what was launched in it; `since`: what comes before
# that, in place of all that was launched.
Beside: TypeAlias = Callable[..., AbstractContextManager[Callable[[], None]]]


class OwnStages(NamedTuple):
    """Stages of a narrow band in place of those of the dense query, each with the same arguments."""

    find_witnesses: Callable[..., None]
    measure_blocks: Callable[..., None]
    mend_slab: Callable[..., None]


class Surface(NamedTuple):
    """The triangles of a batch of meshes, as the stages take them."""

    tree: Tree  # the hierarchy
    frames: wp.array  # the triangles' frames
    features: Features  # their features and neighbours
    cones: Cones  # their cones of normals, and those of the hierarchy's nodes


def _nothing() -> None:
    pass


class Pending(NamedTuple):
    """Calls before parts of a surface are looked at, where those are made beside a query's first stages.

    And one that waits for what comes before the surface, beside which memory is zeroed; None waits for all.
    """

    boundary: Callable[[], Callable[[], None]] = lambda: _nothing  # see `slab_winding`
    cones: Callable[[], None] = _nothing
    features: Callable[[], None] = _nothing
    since: Callable[[], None] | None = None


MADE = Pending()


class Target(NamedTuple):
    """Arrays that a query fills."""

    values: wp.array  # (meshes, n, ny, nz) float32: negative inside
    ambiguous: wp.array  # (meshes,) int32: voxels whose winding number is within 0.25 of 0.5 are added
    # (1,) int64: where the distances go, if not to `values`, which then are workspace; known only when kernels run.
    address: wp.array | None
    # (meshes * n * ny * nz,) int32: what each distance is from, see `dense.block.winners`; the plan then has no splits.
    winners: wp.array | None = None
    searched: wp.array | None = None  # (1,) int32, zero; with winners: 1 if there are any of searched triangles


def query_slab(
    surface: Surface,
    winding: Winding | None,
    slab: Slab,
    target: Target,
    plan: Plan,
    empty: Callable[[int, Any], wp.array],
    beside: Beside,
    pending: Pending = MADE,
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        surface: The meshes.
        winding: Data to find winding numbers by; None for distances without a sign.
        slab: The voxels.
        target: Filled.
        plan: Decisions about the query; distances are exact whatever they are.
        empty: Allocates workspace: `empty(length, dtype)`.
        beside: What is launched in `with beside() as join:` may run beside what comes after it, until `join()`.
        pending: Of the surface and the winding data.
    """
    values = target.values
    work = None if plan.method == "search" else make_workspace(plan, empty)
    with beside(since=pending.since) as zeroed:
        if work is not None:
            work.begin_pass(plan, 0)
    # In the branch of the winding numbers, so that these alone wait for it.
    with beside(since=pending.since):
        crossings = None if winding is None else begin_crossings(winding, slab, values, empty)
    with beside() as join:
        if winding is None:
            values.zero_()
        else:
            # This is bound by memory, and making lists is not.
            boundary = pending.boundary
            slab_winding(surface.tree, winding, slab, values, empty, plan.most_columns, boundary, crossings=crossings)
    out = output_of(target, empty)
    zeroed()
    if work is None:
        pending.cones()
        pending.features()
        join()
        search_slab(surface.tree, slab, out, slab.meshes or values.shape[0])
    else:
        run_stages(surface, slab, out, plan, empty, beside, join, pending=pending, begun=work)


def output_of(target: Target, empty: Callable[[int, Any], wp.array]) -> Any:
    """The target, as kernels take it."""
    out = Output()
    out.elsewhere = 0 if target.address is None else 1
    set_array(out, "values", target.values.flatten())
    set_array(out, "ambiguous", target.ambiguous)
    set_array(out, "address", empty(1, wp.int64) if target.address is None else target.address)
    set_array(out, "winners", empty(0, wp.int32) if target.winners is None else target.winners)
    set_array(out, "searched", empty(0, wp.int32) if target.searched is None else target.searched)
    return out


def query_slabs(
    surface: Surface,
    target: Target,
    parts: Sequence[tuple[Slab, Plan]],
    empty: Callable[[int, Any], wp.array],
    beside: Beside,
) -> None:
    """Signed distances of meshes that differ, on slabs of their own, whose winding numbers are there.

    Args:
        surface: The meshes.
        target: Filled; its values hold the winding numbers before.
        parts: The slabs with the regions of some meshes, and the plan for these; all together have those of all.
        empty: Allocates workspace.
        beside: See `query_slab`.
    """
    out = output_of(target, empty)
    for slab, plan in parts:
        run_stages(surface, slab, out, plan, empty, beside, lambda: None)


def run_stages(
    surface: Surface,
    slab: Slab,
    out: Output,
    plan: Plan,
    empty: Callable[[int, Any], wp.array],
    beside: Beside,
    join_winding: Callable[[], None],
    own: OwnStages | None = None,
    pending: Pending = MADE,
    begun: Workspace | None = None,
) -> None:
    """The seven stages, pass by pass, and a search for what found no room; see `query_slab`.

    `join_winding` is called before winding numbers are looked at. `begun` is the plan's workspace, if there is one
    whose first pass has begun.
    """
    whole, frames, features, cones = surface
    tree = coarser(whole, plan.levels_left_out) if plan.levels_left_out > 0 else whole
    device = out.values.device
    gpu = device.is_cuda
    lanes = GPU_LANES if gpu else 1
    has_splits = plan.split_length < NO_SPLITS
    find, measure, mend = own or (find_witnesses, measure_blocks, mend_slab)

    def workers(blocks_per_sm: int, items: int | None = None) -> int:
        """Groups of lanes, of a GPU no more than there are items: each asks for one, one after the other."""
        if not gpu:
            return 16 * threads()
        most = gpu_workers(device, blocks_per_sm)
        return most if items is None else min(most, -(-items // GPU_GROUPS) * GPU_GROUPS)

    work = begun or make_workspace(plan, empty)
    grid, pool, cache, schedule = work.grid, work.pool, work.cache, work.schedule
    regions, cells, shares, blocks = work.regions, work.cells, work.share_witnesses, work.blocks
    # On a GPU they are in shared memory.
    stacks = empty(1 if gpu else workers(1) * STACK, wp.int32)
    scratch = empty(1 if gpu else workers(1) * scratch_rows(out.winners.shape[0] > 0) * 4, wp.float32)
    # Few cells have lists that are cut: a lane for each four voxels.
    merge_threads = workers(SPLIT_BLOCKS_PER_SM, 2 * plan.most * plan.cell**3 // GPU_LANES) * lanes
    set_array(out, "missed", work.missed)
    for first in range(plan.passes):
        if first > 0 or begun is None:
            work.begin_pass(plan, first)
        most = plan.most
        find(tree, frames, slab, grid, work.counters, cache, workers(SCHEDULE_BLOCKS_PER_SM, most), lanes)
        if first == 0:
            pending.cones()
        at_work = workers(REGION_BLOCKS_PER_SM, most * plan.region_shares)
        list_regions(tree, frames, cones, slab, grid, cache, pool, regions, stacks, at_work, lanes)
        at_work = workers(CELL_BLOCKS_PER_SM, 8 * most * plan.cell_shares)
        list_cells(tree, frames, cones, slab, grid, cache, pool, regions, cells, shares, at_work, lanes)
        if first == 0:
            pending.features()
        schedule_blocks(
            tree,
            frames,
            features,
            slab,
            grid,
            pool,
            cells,
            shares,
            cache,
            schedule,
            plan.split_length,
            workers(SCHEDULE_BLOCKS_PER_SM, 8 * most),
            lanes,
        )
        if has_splits:
            with beside() as join_split:
                # After the winding numbers, which are made there too.
                begin_split(slab, grid, cache, schedule, out, merge_threads)
        if plan.by_brick:
            select_bricks(
                tree,
                features,
                cones,
                slab,
                grid,
                pool,
                cells,
                cache,
                schedule,
                blocks,
                scratch,
                stacks,
                workers(BRICK_BLOCKS_PER_SM),
                lanes,
            )
        select_features(
            tree,
            frames,
            features,
            cones,
            slab,
            grid,
            pool,
            cells,
            cache,
            schedule,
            blocks,
            stacks,
            workers(SELECT_BLOCKS_PER_SM),
            lanes,
        )
        if first == 0:
            # From here on winding numbers are looked at.
            join_winding()
        if has_splits:
            join_split()
        measure(
            tree,
            features,
            slab,
            grid,
            cache,
            schedule,
            pool,
            blocks,
            scratch,
            stacks,
            out,
            workers(BLOCKS_PER_SM),
            lanes,
        )
        if has_splits:
            end_split(slab, grid, cache, schedule, out, merge_threads)
        if plan.list_bricks_below > 0:
            search_bricks(
                tree,
                slab,
                grid,
                pool,
                cells,
                cache,
                schedule,
                out,
                plan.list_bricks_below,
                workers(SEARCH_BLOCKS_PER_SM),
                lanes,
            )
    mend(whole, slab, out, workers(BLOCKS_PER_SM) * lanes)
