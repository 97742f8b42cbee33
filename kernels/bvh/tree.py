"""A bounding volume hierarchy without pointers: triangles along a Hilbert curve under a complete binary tree.

Triangles are sorted along a Hilbert curve and cut into 2^depth runs of nearly equal length, the leaves. Node i has
the children 2i and 2i+1, the root is node 1, leaf j is node 2^depth + j. A batch of meshes has one of everything: mesh
m has its own slice of every array, as long as the others' if the meshes share their faces, else as `parts` says: then
`tree_of` gives its hierarchy. How it is made is in `build`.

Coordinates are scaled by a power of two, which is exact, so that squares neither overflow nor vanish.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import warp as wp

from sdm.kernels.primitives.coalesced_stores import begin_record, end_record, put4, vectors_at
from sdm.kernels.primitives.vector_loads import load4, load4_of_vectors, write4

wp.set_module_options({"enable_backward": False})

# At most, so half as many and more: the leaves are a power of two.
TRIANGLES_PER_LEAF = 5
# At most in a leaf of a coarser tree.
LARGEST_LEAF = 8
BOX_FLOATS = 8
# The projected (y,z) coordinates are snapped to a lattice of this many steps: their cross products fit in int64.
LATTICE_STEPS = wp.float64(2.0**29)
# Two steps of the lattice in scaled units, at most: a mesh is never more than 2 wide. Boxes get this much slack.
LATTICE_SLACK = wp.float64(2.0**-27)

# Entries of a mesh's part, where meshes differ: its first slot, which is its first row of the faces too, its triangles,
# levels, first node, and the last levels that candidate lists do without.
FIRST, COUNT, DEPTH, ROOT, LEFT_OUT, PART_SIZE = 0, 1, 2, 3, 4, 5
# Entries of a mesh's frame; `REACH` is its largest coordinate, scaled.
SCALE, UNSCALE, LOW_X, LOW_Y, LOW_Z, LATTICE, DIAGONAL, REACH, FRAME_SIZE = 0, 1, 2, 3, 4, 5, 6, 7, 8
# Bytes of a triangle's corners and normal.
_CORNERS_SIZE = 48


@wp.struct
class Tree:
    """The hierarchy of a batch of meshes. Triangle `t` of mesh `m` in curve order is slot `slots_of(tree, m) + t`."""

    corners: wp.array(dtype=wp.vec3)  # (4 * slots) corner a, b, c, scaled, and the normal, see `load_corners`
    lattice: wp.array(dtype=wp.vec2i)  # (3 * slots) corners' (y,z) on the lattice
    face: wp.array(dtype=wp.int32)  # (slots) index of the face before sorting
    boxes: wp.array(dtype=wp.float32)  # (meshes * 2^(depth+1) * BOX_FLOATS) low (3), 0, high (3), 0, scaled
    frame: wp.array(dtype=wp.float64)  # (meshes * FRAME_SIZE) scale, its inverse, lattice's origin and steps per unit
    count: wp.int32  # triangles of each mesh
    depth: wp.int32  # levels below the root, of which the last has the leaves
    below: wp.int32  # levels below these, which were built and are not looked at (see `coarser`)
    parts: wp.array(dtype=wp.int32)  # (meshes * PART_SIZE) of meshes that differ: `count` and `depth` are the largest
    meshes: wp.int32  # meshes that differ; 0 if all have as many triangles
    alone: wp.int32  # 1 if this is the hierarchy of one mesh, which begins at:
    first: wp.int32  # its first slot
    root: wp.int32  # and its first node


@lru_cache(maxsize=4096)
def depth_for(faces: int) -> int:
    """Levels below the root for a mesh of `faces` triangles."""
    return max(0, -(-faces // TRIANGLES_PER_LEAF) - 1).bit_length()


def coarser(tree: Tree, levels: int) -> Tree:
    """The same hierarchy without its last levels: each leaf has what 2^levels had."""
    found = Tree()
    for name in Tree.vars:
        setattr(found, name, getattr(tree, name))
    found.depth, found.below = tree.depth - levels, tree.below + levels
    return found


# By addresses that a compiler sees are next to each other, as `three_of` in `geometry.voxel_grid`.
@wp.func_native(snippet="return parts.data[row + entry];")
def part_entry(parts: wp.array(dtype=wp.int32), row: int, entry: int) -> int:
    """An entry of the row of `parts` that begins at `row`."""
    ...


@wp.func
def tree_of(tree: Tree, mesh: int):
    """The hierarchy of one mesh of a batch. Functions that are told the mesh's number take either.

    Values that later code needs are few here, as a GPU's lanes keep them in registers.
    """
    one = of_shared_faces(tree)
    one.alone = 1
    one.first = mesh * tree.count
    one.root = mesh * (2 << (tree.depth + tree.below))
    if tree.meshes > 0:
        part = PART_SIZE * mesh
        one.first = part_entry(tree.parts, part, FIRST)
        one.count = part_entry(tree.parts, part, COUNT)
        one.root = part_entry(tree.parts, part, ROOT)
        one.below = wp.where(tree.below > 0, part_entry(tree.parts, part, LEFT_OUT), 0)
        one.depth = part_entry(tree.parts, part, DEPTH) - one.below
    return one


@wp.func
def of_any_faces(tree: Tree):
    """A kernel's hierarchy, as it is."""
    return tree


@wp.func
def of_shared_faces(tree: Tree):
    """A kernel's hierarchy of meshes that share their faces, see `BY_FACES`."""
    one = Tree()
    one.corners = tree.corners
    one.lattice = tree.lattice
    one.face = tree.face
    one.boxes = tree.boxes
    one.frame = tree.frame
    one.count = tree.count
    one.depth = tree.depth
    one.below = tree.below
    one.meshes = 0
    one.alone = 0
    return one


# Kernels that every map waits for come twice, for meshes that differ and, by [True], for those that share their faces:
# from these a compiler leaves out what is read for others, which costs registers also where there are none. That is a
# tenth of the time of candidate lists (bench/decisions/0050-kernels-of-meshes-alike.md).
BY_FACES = of_any_faces, of_shared_faces


@wp.func_native(
    snippet=f"""
    if (tree.meshes == 0) return slot / tree.count;
    int low = 0, high = tree.meshes;
    while (high - low > 1) {{
        const int middle = (low + high) / 2;
        if (tree.parts.data[{PART_SIZE} * middle + {FIRST}] <= slot) low = middle; else high = middle;
    }}
    return low;
"""
)
def mesh_of_slot(tree: Tree, slot: int) -> int:
    """The mesh whose triangle is in a slot."""
    ...


@wp.func
def slots_of(tree: Tree, mesh: int):
    """The first slot of a mesh."""
    return wp.where(tree.alone != 0, tree.first, mesh * tree.count)


@wp.func
def rows_before(tree: Tree, mesh: int):
    """Rows of the faces before a mesh's own, of a tree of all: none if all meshes share them."""
    before = int(0)
    if tree.meshes > 0:
        before = tree.parts[PART_SIZE * mesh + FIRST]
    return before


def sizes(meshes: int, faces: int) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Shape and Warp type of each array of a `Tree`, for whoever allocates them."""
    slots = meshes * faces
    nodes = meshes << (depth_for(faces) + 1)
    return {
        "corners": ((4 * slots, 3), wp.float32),
        "lattice": ((3 * slots, 2), wp.int32),
        "face": ((slots,), wp.int32),
        "boxes": ((nodes * BOX_FLOATS,), wp.float32),
        "frame": ((meshes * FRAME_SIZE,), wp.float64),
    }


@wp.func
def first_triangle(tree: Tree, leaf: int):
    """The first triangle (in curve order) of a leaf; its end is the first of the next."""
    return int((wp.int64(leaf) * wp.int64(tree.count)) >> wp.int64(tree.depth))


@wp.func
def load_corners(tree: Tree, slot: int):
    """The corners a, b and c of the triangle in a slot (scaled), and its unit normal, zero if it is flat."""
    r0 = load4_of_vectors(tree.corners, 3 * slot)
    r1 = load4_of_vectors(tree.corners, 3 * slot + 1)
    r2 = load4_of_vectors(tree.corners, 3 * slot + 2)
    a = wp.vec3(r0[0], r0[1], r0[2])
    b = wp.vec3(r0[3], r1[0], r1[1])
    c = wp.vec3(r1[2], r1[3], r2[0])
    return a, b, c, wp.vec3(r2[1], r2[2], r2[3])


@wp.func
def write_corners(tree: Tree, slot: int, a: wp.vec3, b: wp.vec3, c: wp.vec3, n: wp.vec3):
    """Write the rows that `load_corners` reads."""
    corners = vectors_at(tree.corners)
    record = begin_record(corners, _CORNERS_SIZE, slot)
    put4(record, 0, a[0], a[1], a[2], b[0])
    put4(record, 1, b[1], b[2], c[0], c[1])
    put4(record, 2, c[2], n[0], n[1], n[2])
    end_record(corners, record, _CORNERS_SIZE, slot, tree.face.shape[0])


@wp.func
def nodes_of(tree: Tree, mesh: int):
    """Offset of a mesh's nodes, which count from there: its root is one further."""
    return wp.where(tree.alone != 0, tree.root, mesh * (2 << (tree.depth + tree.below)))


@wp.func
def node_box(tree: Tree, node: int):
    """The lowest and the highest corner of a node's box (scaled); `node` counts through the batch."""
    low = load4(tree.boxes, 2 * node)
    high = load4(tree.boxes, 2 * node + 1)
    return wp.vec3(low[0], low[1], low[2]), wp.vec3(high[0], high[1], high[2])


@wp.func
def box_distance2(p: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Squared distance of p from a box."""
    dx = wp.max(wp.max(low[0] - p[0], p[0] - high[0]), 0.0)
    dy = wp.max(wp.max(low[1] - p[1], p[1] - high[1]), 0.0)
    dz = wp.max(wp.max(low[2] - p[2], p[2] - high[2]), 0.0)
    return dx * dx + dy * dy + dz * dz


@wp.func
def node_distance2(tree: Tree, node: int, p: wp.vec3):
    """Squared distance of p from a node's box."""
    low, high = node_box(tree, node)
    return box_distance2(p, low, high)


@wp.func
def write_box(tree: Tree, node: int, low: wp.vec3, high: wp.vec3):
    write4(tree.boxes, 2 * node, low[0], low[1], low[2], 0.0)
    write4(tree.boxes, 2 * node + 1, high[0], high[1], high[2], 0.0)


@wp.func
def to_lattice(tree: Tree, mesh: int, y: wp.float64, z: wp.float64):
    """Scaled (y,z) on the mesh's lattice: monotone in each coordinate, and 0..2^29 within the mesh's box.

    A subtraction and a product cannot be fused, so every kernel on every device snaps a point to the same place.
    """
    base = mesh * FRAME_SIZE
    steps = tree.frame[base + LATTICE]
    row = wp.floor((y - tree.frame[base + LOW_X + 1]) * steps)
    column = wp.floor((z - tree.frame[base + LOW_X + 2]) * steps)
    limit = wp.float64(2.0) * LATTICE_STEPS
    return wp.vec2i(int(wp.clamp(row, -limit, limit)), int(wp.clamp(column, -limit, limit)))
