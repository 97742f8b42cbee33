"""Options of plans: decisions that tests and measurements take out of the cost model's hands."""
# pyright: basic

from __future__ import annotations

from dataclasses import dataclass

# Paths of maps and of scattered points: the fast one and the plain one, or the one that is expected to be faster.
MAP_METHODS = ("auto", "cells", "search")
POINT_METHODS = ("auto", "lists", "search")


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Decisions made beforehand; None leaves one to the cost model. Distances are exact whatever they are.

    Args:
        method: Path of maps: `"cells"` is fast, `"search"` plain, `"auto"` the one that is expected to be faster.
        points_method: Path of scattered points: `"lists"` is fast on a GPU, `"search"` plain, `"auto"` either.
        cell: Voxels along the edge of a cell: 4, 8 or 16.
        shares: Groups of lanes that make the candidate list of each region, and of each cell: powers of two, the
            second at most the first.
        block_shares: Groups of lanes that make the list of features of each block: at most 32.
        block_parts: Groups of lanes that measure each block: 1, or with 2, 4 or 8 all of a GPU's thread block; but so
            many where closest points are wanted too.
        split_length: Leaves of a cell's candidate list that one group of lanes takes, at least 1.
        by_brick: True for a list of its own for each brick of a cell of 16^3 voxels, False for one that they share.
        list_split: Leaves of a cell's candidate list that one group of lanes makes such lists of, at least 1.
        levels_left_out: Last levels of the tree that candidate lists do without, as far as it has them.
        pool_entries: Entries of the pool of candidate lists.
        most_regions: Regions of a pass.
        most_columns: Columns of voxels for each lane from which on a triangle is scan converted by many groups.
        list_bricks: True to search coarse bricks by their cells' lists, see `dense.coarse_bricks`; False by the tree.
        slice_factors: Factors by which thick slices may be refined on a CPU; `(1,)` leaves all as they are.
        slab_voxels: Voxels of a slab of the grid that thick slices are refined to, from its thinnest one on.

    Raises:
        ValueError: A method that there is not.
    """

    method: str = "auto"
    points_method: str = "auto"
    cell: int | None = None
    shares: tuple[int, int] | None = None
    block_shares: int | None = None
    block_parts: int | None = None
    split_length: int | None = None
    by_brick: bool | None = None
    list_split: int | None = None
    levels_left_out: int | None = None
    pool_entries: int | None = None
    most_regions: int | None = None
    most_columns: int | None = None
    list_bricks: bool | None = None
    slice_factors: tuple[int, ...] = (1, 2, 4, 8, 16)
    slab_voxels: int = 1 << 23

    def __post_init__(self) -> None:
        if self.method not in MAP_METHODS or self.points_method not in POINT_METHODS:
            raise ValueError(
                f"maps are made by one of {MAP_METHODS} and points answered by one of {POINT_METHODS}, "
                f"not by {self.method!r} and {self.points_method!r}"
            )
