"""The tree of an open mesh's caps, and the multipole moments of its nodes.

Caps are triangles that close the mesh (`sdm.topology.cap_triangles`). Surface and caps together have a whole winding
number, and the surface's own is that number less the caps' share: their solid angle over 4 pi. From afar the caps
under a node are seen as a few moments about the node's centre, with n the normal, y the place and dA the area:

    M1 = sum of n dA,   M2 = sum of sym(n y) dA,   M3 = sum of sym(n y y) dA,   M4 = sum of sym(n y y y) dA,

the dipole and what corrects it, without their traces, which no harmonic function sees. They are exact integrals over
the triangles, in float64, rounded once. `sdm.kernels.winding.cap_field` says how far they are from the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import warp as wp

from sdm.kernels.bvh.build import build_in_frame
from sdm.kernels.bvh.tree import Tree, first_triangle, node_box, tree_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES, wait_for_lanes
from sdm.kernels.primitives.vector_loads import load4, read4, write4
from sdm.kernels.winding.fourth_moment import (
    CubicInDouble,
    Quartic,
    QuarticInDouble,
    all_entries,
    mean_cubic,
    symmetric_cubic,
    symmetric_quartic,
    without_traces,
)

wp.set_module_options({"enable_backward": False})

# A node's moments: centre (3), radius; area, roughness, spread, M1 (3), M2 (5: xx, xy, xz, yy, yz), M3 (7: xxx, xxy,
# xxz, xyy, xyz, yyy, yyz), M4 (9, `fourth_moment`): the rest follows from zero traces. One is unused.
MOMENTS_SIZE = 32
_ROWS = MOMENTS_SIZE // 4
# The rounding of a node's part of the solid angle, times its squared distance: of all float32 numbers on the way, by
# area, and of the places on the lattice, which are those that count, by the length of the caps' edges.
AREA_ROUNDING = wp.float64(280.0 * 2.0**-24)
EDGE_ROUNDING = wp.float64(0.25 * 2.0**-24)
# No radius or spread is too small by rounding. A node's centre is its area's middle but for so much, scaled.
WIDER = wp.float64(1.00001)
OFF_MIDDLE = wp.float64(2.0**-22)
# Levels of moments that one launch makes: each takes as long as two launches.
LEVELS_AT_ONCE = 4

# The entries xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz and zzz of a symmetric tensor.
Cubic = wp.types.vector(length=10, dtype=wp.float32)


@wp.struct
class Caps:
    """The caps of each mesh of a batch, as many as it has boundary edges; some of them without an area."""

    tree: Tree  # with the meshes' own frame, and at most one cap in a leaf
    moments: wp.array(dtype=wp.float32)  # (nodes * MOMENTS_SIZE)
    are_faces: wp.int32  # 1 if they are the mesh's own faces, inside out: together nothing is left


@wp.struct
class Moments:
    """The moments of a node, M2 and M3 without traces."""

    centre: wp.vec3
    radius: float
    area: float
    rough: float  # of the rounding of its solid angle, times the squared distance
    spread: float  # the root of the mean squared distance of its area from the centre
    m1: wp.vec3
    m2: wp.mat33
    m3: Cubic


@wp.struct
class Sums:
    """The moments of a node while they are added up, with traces."""

    centre: wp.vec3
    radius: wp.float64
    area: wp.float64
    rough: wp.float64
    square: wp.float64  # the area times the squared spread
    m1: wp.vec3d
    m2: wp.mat33d
    m3: CubicInDouble
    m4: QuarticInDouble


def depth_of_caps(count: int) -> int:
    """Levels below the root of a tree of so many caps: a leaf for each."""
    return max(0, (count - 1).bit_length())


@wp.func
def unpacked(r0: wp.vec4, r1: wp.vec4, r2: wp.vec4, r3: wp.vec4, r4: wp.vec4, r5: wp.vec4):
    m = Moments()
    m.centre = wp.vec3(r0[0], r0[1], r0[2])
    m.radius = r0[3]
    m.area = r1[0]
    m.rough = r1[1]
    m.spread = r1[2]
    m.m1 = wp.vec3(r1[3], r2[0], r2[1])
    m.m2 = wp.mat33(r2[2], r2[3], r3[0], r2[3], r3[1], r3[2], r3[0], r3[2], -r2[2] - r3[1])
    m.m3[0] = r3[3]
    m.m3[1] = r4[0]
    m.m3[2] = r4[1]
    m.m3[3] = r4[2]
    m.m3[4] = r4[3]
    m.m3[5] = -r3[3] - r4[2]
    m.m3[6] = r5[0]
    m.m3[7] = r5[1]
    m.m3[8] = -r4[0] - r5[0]
    m.m3[9] = -r4[1] - r5[1]
    return m


@wp.func
def read_moments(moments: wp.array(dtype=wp.float32), node: int):
    """A node's moments, of an array that this kernel writes too."""
    at = _ROWS * node
    return unpacked(
        read4(moments, at),
        read4(moments, at + 1),
        read4(moments, at + 2),
        read4(moments, at + 3),
        read4(moments, at + 4),
        read4(moments, at + 5),
    )


@wp.func
def fourth_of(r5: wp.vec4, r6: wp.vec4, r7: wp.vec4):
    """A node's fourth moment, from the last rows."""
    m4 = Quartic()
    m4[0] = r5[2]
    m4[1] = r5[3]
    m4[2] = r6[0]
    m4[3] = r6[1]
    m4[4] = r6[2]
    m4[5] = r6[3]
    m4[6] = r7[0]
    m4[7] = r7[1]
    m4[8] = r7[2]
    return m4


@wp.func
def read_fourth(moments: wp.array(dtype=wp.float32), node: int):
    """A node's fourth moment, of an array that this kernel writes too."""
    at = _ROWS * node
    return fourth_of(read4(moments, at + 5), read4(moments, at + 6), read4(moments, at + 7))


@wp.func
def load_fourth(moments: wp.array(dtype=wp.float32), node: int):
    """A node's fourth moment, of an array that nobody writes meanwhile."""
    at = _ROWS * node
    return fourth_of(load4(moments, at + 5), load4(moments, at + 6), load4(moments, at + 7))


@wp.func
def load_rest(moments: wp.array(dtype=wp.float32), node: int, r0: wp.vec4, r1: wp.vec4):
    """A node's moments, whose first two rows are there already, of an array that nobody writes meanwhile."""
    at = _ROWS * node
    return unpacked(
        r0, r1, load4(moments, at + 2), load4(moments, at + 3), load4(moments, at + 4), load4(moments, at + 5)
    )


@wp.func
def write_sums(moments: wp.array(dtype=wp.float32), node: int, s: Sums):
    """Write a node's moments, without their traces."""
    trace = wp.trace(s.m2) / wp.float64(3.0)
    fifth = wp.float64(0.2)
    three = wp.float64(3.0)
    tx = fifth * (s.m3[0] + s.m3[3] + s.m3[5])
    ty = fifth * (s.m3[1] + s.m3[6] + s.m3[8])
    tz = fifth * (s.m3[2] + s.m3[7] + s.m3[9])
    at = _ROWS * node
    write4(moments, at, s.centre[0], s.centre[1], s.centre[2], float(s.radius * WIDER))
    spread = wp.float64(0.0)
    if s.area > wp.float64(0.0):
        spread = wp.sqrt(s.square / s.area)
    write4(moments, at + 1, float(s.area), float(s.rough), float(spread * WIDER), float(s.m1[0]))
    xx = float(s.m2[0, 0] - trace)
    write4(moments, at + 2, float(s.m1[1]), float(s.m1[2]), xx, float(s.m2[0, 1]))
    xxx = float(s.m3[0] - three * tx)
    write4(moments, at + 3, float(s.m2[0, 2]), float(s.m2[1, 1] - trace), float(s.m2[1, 2]), xxx)
    write4(moments, at + 4, float(s.m3[1] - ty), float(s.m3[2] - tz), float(s.m3[3] - tx), float(s.m3[4]))
    m4 = without_traces(s.m4)
    write4(moments, at + 5, float(s.m3[6] - three * ty), float(s.m3[7] - tz), m4[0], m4[1])
    write4(moments, at + 6, m4[2], m4[3], m4[4], m4[5])
    write4(moments, at + 7, m4[6], m4[7], m4[8], 0.0)


@wp.func
def symmetric(v: wp.vec3d, t: wp.vec3d):
    """sym(v t)."""
    return wp.float64(0.5) * (wp.outer(v, t) + wp.outer(t, v))


@wp.kernel
def _leaf_moments(begin: int, caps: Caps):
    i = begin + wp.tid()
    mesh = i >> caps.tree.depth
    leaf = i - (mesh << caps.tree.depth)
    tree = tree_of(caps.tree, mesh)
    leaves = 1 << tree.depth
    if leaf >= leaves:
        return
    slot = first_triangle(tree, leaf)
    s = Sums()
    if slot < first_triangle(tree, leaf + 1):
        slot = tree.first + slot
        a = wp.vec3d(tree.corners[4 * slot])
        b = wp.vec3d(tree.corners[4 * slot + 1])
        c = wp.vec3d(tree.corners[4 * slot + 2])
        part = wp.float64(1.0) / wp.float64(3.0)
        s.centre = wp.vec3(part * (a + b + c))
        s.m1 = wp.float64(0.5) * wp.cross(b - a, c - a)
        s.area = wp.length(s.m1)
        around = wp.length(b - a) + wp.length(c - b) + wp.length(a - c)
        s.rough = AREA_ROUNDING * s.area + EDGE_ROUNDING * around
        a = a - wp.vec3d(s.centre)
        b = b - wp.vec3d(s.centre)
        c = c - wp.vec3d(s.centre)
        s.radius = wp.max(wp.length(a), wp.max(wp.length(b), wp.length(c)))
        total = a + b + c
        s.m2 = symmetric(s.m1, part * total)
        yy = wp.outer(a, a) + wp.outer(b, b) + wp.outer(c, c) + wp.outer(total, total)
        s.square = s.area * wp.trace(yy) / wp.float64(12.0)
        s.m3 = symmetric_cubic(yy / wp.float64(12.0), s.m1)
        s.m4 = symmetric_quartic(mean_cubic(a, b, c), s.m1)
    write_sums(caps.moments, tree.root + leaves + leaf, s)


@wp.func
def moved(s: Sums, m: Moments, m4: Quartic):
    """Add a child's moments to those of a node, whose centre is known."""
    m1 = wp.vec3d(m.m1)
    m2 = wp.mat33d(m.m2)
    t = wp.vec3d(m.centre) - wp.vec3d(s.centre)
    if m.rough > 0.0:
        s.radius = wp.max(s.radius, wp.float64(m.radius) + wp.length(t))
    s.area = s.area + wp.float64(m.area)
    spread = wp.float64(m.spread)
    s.square = s.square + wp.float64(m.area) * (spread * spread + wp.dot(t, t) + OFF_MIDDLE * wp.length(t))
    s.rough = s.rough + wp.float64(m.rough)
    s.m1 = s.m1 + m1
    s.m2 = s.m2 + m2 + symmetric(m1, t)
    three = wp.float64(3.0)
    m2t = symmetric_cubic(m2, t)
    m1tt = symmetric_cubic(wp.outer(t, t), m1)
    m3 = wp.float64(2.0) * m2t + m1tt
    m3tt = three * m2t + m1tt
    for i in range(10):
        s.m3[i] = s.m3[i] + m3[i] + wp.float64(m.m3[i])
        m3tt[i] = m3tt[i] + three * wp.float64(m.m3[i])
    s.m4 = s.m4 + all_entries(m4) + symmetric_quartic(m3tt, t)
    return s


@wp.func
def join_children(caps: Caps, base: int, node: int):
    """Write a node's moments from those of its children."""
    tree = caps.tree
    left = read_moments(caps.moments, base + 2 * node)
    right = read_moments(caps.moments, base + 2 * node + 1)
    s = Sums()
    first = wp.float64(left.area)
    second = wp.float64(right.area)
    if first + second == wp.float64(0.0):
        # Caps without an area have their edges somewhere.
        first = wp.float64(left.rough)
        second = wp.float64(right.rough)
    if first + second > wp.float64(0.0):
        s.centre = wp.vec3((first * wp.vec3d(left.centre) + second * wp.vec3d(right.centre)) / (first + second))
    s = moved(s, left, read_fourth(caps.moments, base + 2 * node))
    s = moved(s, right, read_fourth(caps.moments, base + 2 * node + 1))
    low, high = node_box(tree, base + node)
    reach = wp.max(wp.vec3d(s.centre) - wp.vec3d(low), wp.vec3d(high) - wp.vec3d(s.centre))
    s.radius = wp.min(s.radius, wp.length(reach))
    # Children are rounded already.
    s.rough = s.rough + AREA_ROUNDING * wp.float64(0.125) * s.area
    write_sums(caps.moments, base + node, s)


@wp.kernel
def _join_levels(begin: int, lanes: int, caps: Caps, lowest: int, width: int, most: int):
    """Moments of up to `most` levels, the lowest of them so many above the leaves: one group of lanes for what is below
    each node of the highest, and `width` groups for each mesh.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    group = thread / lanes
    mesh = group / width
    one = tree_of(caps.tree, mesh)
    levels = wp.min(one.depth - lowest + 1, most)
    highest = one.depth - lowest + 1 - levels
    top = (1 << highest) + group - mesh * width
    # Of meshes that differ, one with fewer levels takes fewer groups.
    if levels <= 0 or top >= 2 << highest:
        return
    base = one.root
    for back in range(levels):
        down = levels - 1 - back
        node = (top << down) + lane
        while node < (top + 1) << down:
            join_children(caps, base, node)
            node = node + lanes
        wait_for_lanes()


def _nothing() -> None:
    pass


def build_caps(
    caps: Caps,
    vertices: wp.array,
    triangles: wp.array,
    bounds: wp.array,
    keys: wp.array,
    slots: wp.array,
    *,
    fillers: bool = False,
    beside: Callable[[], AbstractContextManager[Callable[[], None]]] | None = None,
) -> Callable[[], None]:
    """Fill `caps`, whose tree has the meshes' frame.

    Args:
        caps: What to fill.
        vertices: (meshes, V) vec3.
        triangles: (E, 3) int32, shared by the meshes; of meshes that differ one after the other.
        bounds: (6 * meshes) float32, each mesh's lowest and highest coordinates.
        keys: (2 * meshes * E) int64, workspace.
        slots: (2 * meshes * E) int32, workspace.
        fillers: See `build_tree`.
        beside: The moments are launched in `with beside() as join:`.

    Returns:
        That `join`, to be called before moments are read.
    """
    tree, device = caps.tree, vertices.device
    # The caps' own normals have no use: they go where the moments come afterwards.
    build_in_frame(tree, vertices, triangles, bounds, keys, slots, caps.moments, fillers=fillers)
    with beside() if beside else nullcontext(_nothing) as join:
        _make_moments(caps, vertices.shape[0], device)
    return join


def _make_moments(caps: Caps, meshes: int, device: Any) -> None:
    tree = caps.tree
    launch(_leaf_moments, meshes << tree.depth, [caps], device)
    lanes = GPU_LANES if device.is_cuda else 1
    level = tree.depth
    while level > 0:
        # A launch costs more than a few nodes one after the other.
        lowest, levels = tree.depth + 1 - level, min(level, LEVELS_AT_ONCE)
        level -= levels
        launch(_join_levels, (meshes << level) * lanes, [lanes, caps, lowest, 1 << level, levels], device, smallest=8)
