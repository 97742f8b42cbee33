"""Capacity classes: meshes and grids that one recording serves, whatever the mesh's counts and the grid's place.

A class has room for so many faces and vertices, for grids of one shape, and cells of one size. How many faces a mesh
has, where its grid is, and what else decides about the bits of a value, the kernels read from memory: its tree's depth,
and of its plan the shares of lists and the levels that these leave out.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from sdm.core.grid import IDENTITY, Grid
from sdm.engine.plan_override import OPTIONS, USUAL
from sdm.engine.structure.sizes import MOST_BOUNDARY_EDGES, MeshKind
from sdm.kernels.bvh.tree import TRIANGLES_PER_LEAF, depth_for
from sdm.kernels.dense.cost_model import UNEVEN, leaves_are_long, levels_of_large_leaves, shares_of, uneven_room
from sdm.kernels.dense.plan import Decisions, Plan, Workload, decide, is_by_brick, joint_plan, make_plan
from sdm.kernels.geometry.voxel_grid import CELL_SHARES, REGION, REGION_SHARES, SLAB_ROW, SPACING, VOXEL
from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.winding.cap_tree import depth_of_caps
from sdm.kernels.winding.rims.every_voxel import MOST_SUMS

# Most faces of the classes of small meshes, which cost a GPU about the same whatever their faces, and of the largest:
# of more, kernels take longer than the host. One block sorts 4,864 short keys: the edges of the first class, the faces
# of the second, and the one that is more.
SMALL, LARGEST = (1620, 4863, 20480, 81920), 1 << 20
# Room for unmatched edges, and for boundary edges, of open meshes: a tree of caps has room for one more.
MOST_EDGES = 2 * MOST_BOUNDARY_EDGES - 1
# And of meshes that have more, for which it would cost others some sorts of as many.
MANY_EDGES, LARGEST_ROOM = 8 * MOST_BOUNDARY_EDGES - 1, 32 * MOST_BOUNDARY_EDGES - 1
ROOMS = MOST_EDGES, MANY_EDGES, LARGEST_ROOM
# And of those with more edges than faces, so that the faces turned inside out are fewer caps than triangles between the
# edges: one more, so that a recording is known by its room.
BY_FACES = tuple(room + 1 for room in ROOMS)
# A recording for many edges is made for meshes that have them: for which so many are too few.
TOO_FEW: dict[int, int] = dict(zip(ROOMS[1:], ROOMS[:-1], strict=True))
# Least room for boundary edges that is worth recordings of their own for meshes with few.
LEAST_FEW = 32
# Larger classes that may serve a mesh until its own is worth a recording.
LARGER = 2
# Vertices for each face of the room: of closed surfaces, or of triangles that share none.
SHARED, LOOSE = 0.75, 3.0


@dataclass(frozen=True, eq=False)
class CapacityClass:
    """Meshes and grids that one recording serves.

    Args:
        most: Faces of the largest mesh.
        vertices: Room for vertices.
        shape: Voxels of the grid.
        turned: True if its axes are not x, y and z.
        plan: Of the map.
    """

    most: int
    vertices: int
    shape: tuple[int, int, int]
    turned: bool
    plan: Plan

    @property
    def faces(self) -> int:
        """Room for faces: those behind the mesh's own are of a second mesh, which always has one."""
        return self.most + 1

    @property
    def sizes(self) -> PairSizes:
        """Sizes of the structure of both, if the mesh is closed."""
        return PairSizes(self.most, self.faces, (2 << depth_for(self.most)) + 2)

    @cached_property
    def row_of_none(self) -> list[float]:
        """The row of a slab without voxels, behind another."""
        none: list[float] = [0.0] * SLAB_ROW
        none[SPACING : SPACING + 3], none[VOXEL], none[REGION] = (1.0, 1.0, 1.0), math.prod(self.shape), self.plan.total
        none[REGION_SHARES], none[CELL_SHARES] = self.plan.region_shares, self.plan.cell_shares
        return none

    def few_edges(self, device: str) -> int:
        """Room for boundary edges that are so few that each voxel gets the sum over them, on `"cuda"` or `"cpu"`.

        Neither caps nor boxes are needed then. 0: the grid is so large that hardly any mesh has so few.
        """
        return _few_edges(self.shape, MOST_SUMS[device])

    def rooms(self, device: str) -> tuple[int, ...]:
        """Room for edges of the recordings for open meshes on such a device, from the least on."""
        few = self.few_edges(device)
        return (few, *ROOMS) if few else ROOMS

    def open_sizes(self, room: int) -> PairSizes:
        """Sizes of the structure of both, with room for so many boundary edges of the mesh."""
        caps = self.faces if room in BY_FACES else room + 1
        return self.sizes._replace(
            edges=room,
            visited_edges=room,
            caps=caps,
            all_caps=caps,
            cap_nodes=2 * (2 << depth_of_caps(caps)),
            kind=MeshKind.OPEN,
        )


class PairSizes(NamedTuple):
    """Sizes that the shapes of all arrays follow from, as `Sizes`: of a mesh, and of the faces behind its own."""

    faces: int  # of the larger one, at most
    slots: int
    nodes: int
    meshes: int = 2
    edges: int = 0
    visited_edges: int = 0
    cap_nodes: int = 0
    dipole_nodes: int = 0
    caps: int = 0
    all_caps: int = 0
    kind: MeshKind = MeshKind.CLOSED


@lru_cache(maxsize=64)
def _few_edges(shape: tuple[int, int, int], most_sums: float) -> int:
    room = min(most_sums / math.prod(shape), MOST_EDGES)
    return int(room) if room >= LEAST_FEW else 0


def bounds_of(faces: int) -> tuple[int, int]:
    """Least and most faces of the class of a mesh with so many."""
    least = 1
    for most in SMALL:
        # Trees of other depths are no deeper than that of the largest.
        if faces <= most:
            return least, most
        least = most + 1
    most = TRIANGLES_PER_LEAF << depth_for(faces)
    # Two for each depth, so that no more than a third of the room is idle.
    middle = most - most // 4
    return (middle + 1, most) if faces > middle else (most // 2 + 1, middle)


def class_of(faces: int, vertices: int, grid: Grid, memory: int | None) -> tuple[CapacityClass, Decisions] | None:
    """The class of a mesh and a grid on a device with so much memory (see `make_plan`), and what is decided about it.

    None if there is none; the same object for all its meshes.
    """
    if not 0 < faces <= LARGEST:
        return None
    options, turned = OPTIONS.get(), grid.direction is not IDENTITY and grid.direction != IDENTITY
    x, y, z = grid.spacing
    uneven = turned or (not x == y == z and uneven_room(grid.spacing, turned) > 1)
    # What is asked first is little: it is asked before anything is launched.
    most = MOSTS[bisect_left(MOSTS, faces)]
    room = int(SHARED * most)
    if vertices > room:
        room = int(LOOSE * most)
    key = most, room, grid.shape, turned, uneven, memory
    if options is USUAL:
        usual = _usual.get(key)
        if usual is not None:
            return usual if vertices <= room else None
    least, most = bounds_of(faces)
    decisions = _of_all(least, most, grid.shape, memory is not None, options)
    for_all = decisions is not None
    if decisions is None:
        # All that decides about bits, and no more: a plan takes the host as long as some launches.
        decisions = _decided(faces, grid.shape, memory is not None, options)
    if vertices > room or decisions.method != "cells":
        return None
    kind = _class(most, room, grid.shape, turned, uneven, decisions.cell, memory, options)
    if kind is None:
        return None
    if for_all and options is USUAL:
        # To hash the options takes the host longer than all else here.
        if len(_usual) >= MOST_KEPT:
            _usual.clear()
        _usual[key] = kind, decisions
    return kind, decisions


def has_room_for(larger: CapacityClass, kind: CapacityClass) -> bool:
    """True if a larger class has room for what decides about the bits of any mesh of a class."""
    plan, own = larger.plan, kind.plan
    return (
        plan.region_shares >= own.region_shares
        and plan.cell_shares >= own.cell_shares
        and plan.levels_left_out >= own.levels_left_out
    )


def is_usual(kind: CapacityClass, memory: int | None) -> bool:
    """True if meshes that share vertices are of this class, on grids of cubic voxels that are not turned."""
    most, cell = kind.most, kind.plan.cell
    return kind is _class(most, int(SHARED * most), kind.shape, False, False, cell, memory, USUAL)


@lru_cache(maxsize=256)
def stretches(most: int, shape: tuple[int, int, int], gpu: bool) -> tuple[list[int], list[Decisions]]:
    """Most faces of each stretch of meshes of a class about which the same is decided, and that, by the usual options.

    As `_of_all` says, what is the same at both ends of a stretch of trees of one depth is so in between.
    """
    ends = _ends(*bounds_of(most))
    found: list[tuple[int, Decisions]] = []

    def at(faces: int) -> tuple[Decisions, bool]:
        return _decided(faces, shape, gpu, USUAL), leaves_are_long(faces, shape)

    # From the last on, as they are taken from the end.
    left = [(begin, at(begin), end, at(end)) for begin, end in zip(ends[::2], ends[1::2], strict=True)][::-1]
    while left:
        begin, first, end, last = left.pop()
        if first == last or begin == end:
            found.append((end, last[0]))
        else:
            middle = (begin + end) // 2
            left += [(middle + 1, at(middle + 1), end, last), (begin, first, middle, at(middle))]
    # Neighbours that are alike are one.
    kept = [one for one, after in zip(found, [*found[1:], None], strict=True) if after is None or one[1] != after[1]]
    return [faces for faces, _ in kept], [decisions for _, decisions in kept]


def _mosts() -> list[int]:
    """Most faces of each class, from the smallest on."""
    found = [bounds_of(1)[1]]
    while found[-1] < LARGEST:
        found.append(bounds_of(found[-1] + 1)[1])
    return found


MOSTS = _mosts()
# Classes by the usual options, with decisions that are those about all their meshes.
_usual: dict[tuple[Any, ...], tuple[CapacityClass, Decisions]] = {}
MOST_KEPT = 256


def larger_classes(
    kind: CapacityClass, decisions: Decisions, grid: Grid, memory: int | None
) -> Iterator[CapacityClass]:
    """The next larger classes, from the smallest on, that serve a mesh of a class about which so much is decided."""
    most, uneven = kind.most, uneven_room(grid.spacing, kind.turned) > 1
    for _step in range(LARGER):
        if most >= LARGEST:
            return
        _, most = bounds_of(most + 1)
        found = _class(most, int(SHARED * most), grid.shape, kind.turned, uneven, decisions.cell, memory, OPTIONS.get())
        if found is None or found.vertices < kind.vertices:
            continue
        # Of all that decides about bits there is room for what the mesh has.
        plan, own = found.plan, kind.plan
        if (
            plan.region_shares >= decisions.region_shares
            and plan.cell_shares >= decisions.cell_shares
            and plan.levels_left_out >= decisions.levels_left_out
            and plan.list_bricks_below == own.list_bricks_below
        ):
            yield found


def _decided(faces: int, shape: tuple[int, int, int], gpu: bool, options: PlanOptions) -> Decisions:
    # Of the grid nothing but its shape matters.
    return decide(Workload(faces, depth_for(faces), 1, shape, (1.0, 1.0, 1.0), turned=False), gpu, options)


def _ends(least: int, most: int) -> list[int]:
    """The smallest and the largest mesh of each depth of trees, of those with so many faces."""
    found = []
    for depth in range(depth_for(least), depth_for(most) + 1):
        begin = (TRIANGLES_PER_LEAF << (depth - 1)) + 1 if depth else 1
        found += [max(least, begin), min(most, TRIANGLES_PER_LEAF << depth)]
    return found


@lru_cache(maxsize=256)
def _of_all(least: int, most: int, shape: tuple[int, int, int], gpu: bool, options: PlanOptions) -> Decisions | None:
    """The decisions about all meshes with `least` to `most` faces, if they are the same for all.

    Of trees of one depth each decision but the last one only grows with faces, or only falls; and that one does where
    lists are long, and where they are short. So the ends of such stretches tell.
    """
    found = {(_decided(faces, shape, gpu, options), leaves_are_long(faces, shape)) for faces in _ends(least, most)}
    return next(iter(found))[0] if len(found) == 1 else None


@lru_cache(maxsize=256)
def _class(
    most: int,
    room: int,
    shape: tuple[int, int, int],
    turned: bool,
    uneven: bool,
    cell: int,
    memory: int | None,
    options: PlanOptions,
) -> CapacityClass | None:
    gpu = memory is not None
    work = Workload(most, depth_for(most), 1, shape, (1.0, 1.0, UNEVEN if uneven else 1.0), turned)
    # Room for the shares of each mesh, of which the largest has most, and whether there are levels to leave out, most
    # of them by the smallest of a depth. What a mesh has of both is in its table.
    region_shares, cell_shares = options.shares or (shares_of(most, shape, cell) if gpu else (1, 1))
    left_out = options.levels_left_out
    if left_out is None:
        ends = _ends(*bounds_of(most)) if leaves_are_long(most, shape) else []
        left_out = max((levels_of_large_leaves(faces, depth_for(faces)) for faces in ends), default=0)
    own = replace(
        make_plan(work, memory, options),
        cell=cell,
        total=math.prod(-(-n // (2 * cell)) for n in shape),
        region_shares=region_shares,
        cell_shares=cell_shares,
        levels_left_out=_decided(most, shape, gpu, options).levels_left_out,
        by_brick=is_by_brick(work, cell, gpu, options),
    )
    plan = replace(joint_plan([work], [own], memory, options), levels_left_out=left_out)
    return CapacityClass(most, room, shape, turned, plan) if plan.passes == 1 else None
