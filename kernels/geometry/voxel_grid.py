"""A slab of a grid: its voxel centres, rounded to float32, at which distances are measured, and their values."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# A winner's number for a triangle of which it is not known what is nearest, see `dense.block.winners`.
SEARCHED = 7


# Entries of a slab's row, where each mesh of a batch has a grid of its own: origin, spacing, axes, the slab's shape,
# its first layer, its first voxel and first region in the count of all, and shares of its regions' and cells' lists.
ORIGIN, SPACING, AXES, SHAPE, LAYER, VOXEL, REGION, REGION_SHARES, CELL_SHARES = 0, 3, 6, 15, 18, 19, 20, 21, 22
SLAB_ROW = 23


@wp.struct
class Slab:
    """The voxels `first <= i < first + shape[0]` of a grid; of meshes that have grids of their own see `slab_of`."""

    origin: wp.vec3d  # centre of the grid's voxel (0,0,0)
    spacing: wp.vec3d
    axes: wp.mat33d  # if turned: columns from one voxel to the next along i, j and k
    turned: wp.int32  # 0 if the grid's axes are x, y and z
    shape: wp.vec3i  # of the slab; of meshes that have grids of their own the longest along each axis
    first: wp.int32
    rows: wp.array(dtype=wp.float64)  # (meshes * SLAB_ROW) of meshes that have grids of their own
    meshes: wp.int32  # how many they are; 0 if all meshes have the same
    alone: wp.int32  # 1 if this is the slab of one mesh
    start: wp.int32  # and the number of its first voxel


# By addresses that a compiler sees are next to each other: an array's own places cost three instructions each, and this
# is in every kernel of a map, see bench/decisions/0001-kernel-code-size.md.
@wp.func_native(
    """
    const double* from = rows.data + row;
    return wp::vec3d(from[entry], from[entry + 1], from[entry + 2]);
"""
)
def three_of(rows: wp.array(dtype=wp.float64), row: int, entry: int) -> wp.vec3d:
    """Three numbers of the row that begins at `row`."""
    ...


@wp.func_native(snippet="return (int)rows.data[row + entry];")
def whole_of(rows: wp.array(dtype=wp.float64), row: int, entry: int) -> int:
    """A whole number of that row."""
    ...


@wp.func
def slab_of(slab: Slab, mesh: int):
    """The slab of one mesh of a batch. Functions that are told the mesh's number take either.

    Either all grids are turned, or none is. To be called anew wherever it is needed: what is read again is better than
    what a GPU's lanes keep in registers.
    """
    one = of_shared_grid(slab)
    one.alone = 1
    one.start = mesh * slab.shape[0] * slab.shape[1] * slab.shape[2]
    if slab.meshes > 0:
        row = SLAB_ROW * mesh
        one.origin = three_of(slab.rows, row, ORIGIN)
        one.spacing = three_of(slab.rows, row, SPACING)
        one.shape = wp.vec3i(three_of(slab.rows, row, SHAPE))
        one.first = whole_of(slab.rows, row, LAYER)
        one.start = whole_of(slab.rows, row, VOXEL)
        if slab.turned != 0:
            one.axes = wp.matrix_from_rows(
                three_of(slab.rows, row, AXES),
                three_of(slab.rows, row, AXES + 3),
                three_of(slab.rows, row, AXES + 6),
            )
    return one


@wp.func
def of_any_grid(slab: Slab):
    """A kernel's slab, as it is."""
    return slab


@wp.func
def of_shared_grid(slab: Slab):
    """A kernel's slab of meshes that share their grid, see `BY_FACES` in `bvh.tree`."""
    one = Slab()
    one.origin = slab.origin
    one.spacing = slab.spacing
    one.axes = slab.axes
    one.turned = slab.turned
    one.shape = slab.shape
    one.first = slab.first
    one.meshes = 0
    one.alone = 0
    return one


BY_GRID = of_any_grid, of_shared_grid


@wp.func_native(
    snippet=f"""
    int low = 0, high = slab.meshes;
    while (high - low > 1) {{
        const int middle = (low + high) / 2;
        if (slab.rows.data[{SLAB_ROW} * middle + entry] <= (double)number) low = middle; else high = middle;
    }}
    return low;
"""
)
def mesh_in_rows(slab: Slab, entry: int, number: int) -> int:
    """The mesh of a voxel or region, by the VOXEL or REGION entry of the rows."""
    ...


@wp.func
def start_of_mesh(slab: Slab, mesh: int):
    """The number of a mesh's first voxel, counting through the meshes of a batch."""
    return wp.where(slab.alone != 0, slab.start, mesh * slab.shape[0] * slab.shape[1] * slab.shape[2])


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __dmul_rn(a, b);
#else
    return a * b;
#endif
"""
)
def rounded_product(a: wp.float64, b: wp.float64) -> wp.float64:
    """a * b, rounded before anything is added to it: a fused product would move voxels from where the host has them."""
    ...


@wp.func
def along(slab: Slab, axis: int, index: int):
    """The coordinate of a voxel centre of a grid that is not turned, rounded to float32: the point that is measured."""
    i = index
    if axis == 0:
        i = index + slab.first
    return float(slab.origin[axis] + rounded_product(wp.float64(i), slab.spacing[axis]))


@wp.func
def along_turned(slab: Slab, axis: int, i: wp.vec3d):
    """The same coordinate of a grid that is turned."""
    moved = rounded_product(slab.axes[axis, 0], i[0]) + rounded_product(slab.axes[axis, 1], i[1])
    return float(slab.origin[axis] + (moved + rounded_product(slab.axes[axis, 2], i[2])))


@wp.func
def way(slab: Slab, steps: wp.vec3d):
    """Displacement of so many steps along each axis."""
    if slab.turned != 0:
        return slab.axes * steps
    return wp.cw_mul(slab.spacing, steps)


@wp.func
def voxel(slab: Slab, i: int, j: int, k: int):
    """A voxel centre, rounded to float32: bit for bit what `sdm.Grid.points` gives."""
    if slab.turned != 0:
        at = wp.vec3d(wp.float64(i + slab.first), wp.float64(j), wp.float64(k))
        return wp.vec3(along_turned(slab, 0, at), along_turned(slab, 1, at), along_turned(slab, 2, at))
    return wp.vec3(along(slab, 0, i), along(slab, 1, j), along(slab, 2, k))


@wp.func
def count_below(slab: Slab, axis: int, x: wp.float64, scale: wp.float64):
    """Number of the slab's voxels along an axis with a (scaled) coordinate below x; the grid is not turned."""
    count = slab.shape[axis]
    first = 0
    if axis == 0:
        first = slab.first
    guess = (x / scale - slab.origin[axis]) / slab.spacing[axis] - wp.float64(first)
    index = int(wp.clamp(guess, wp.float64(0.0), wp.float64(count)))
    # The guess is off by a voxel at most; what counts is the rounded coordinate itself.
    while index > 0 and scale * wp.float64(along(slab, axis, index - 1)) >= x:
        index = index - 1
    while index < count and scale * wp.float64(along(slab, axis, index)) < x:
        index = index + 1
    return index


@wp.func
def unravel(number: int, shape: wp.vec3i):
    """The mesh and the indices that `number` stands for, counting through a batch of this shape, k fastest."""
    k = number % shape[2]
    rest = number / shape[2]
    j = rest % shape[1]
    rest = rest / shape[1]
    return rest / shape[0], wp.vec3i(rest % shape[0], j, k)


@wp.func
def voxel_at(slab: Slab, number: int):
    """The mesh and the indices of a voxel, counted as by `index_of`."""
    if slab.meshes > 0:
        mesh = mesh_in_rows(slab, VOXEL, number)
        one = slab_of(slab, mesh)
        _none, at = unravel(number - one.start, one.shape)
        return mesh, at
    mesh, at = unravel(number, slab.shape)
    return mesh, at


@wp.func
def index_of(slab: Slab, mesh: int, at: wp.vec3i):
    """The number of a voxel, counting through the meshes of a batch, k fastest: there are at most 2^30."""
    return start_of_mesh(slab, mesh) + (at[0] * slab.shape[1] + at[1]) * slab.shape[2] + at[2]


@wp.struct
class Output:
    """Output of a dense query, voxel by voxel as `index_of` counts them: the values hold winding numbers before."""

    values: wp.array(dtype=wp.float32)
    elsewhere: wp.int32  # 1 if distances do not take the winding numbers' place, but go to an address
    address: wp.array(dtype=wp.int64)  # (1)
    ambiguous: wp.array(dtype=wp.int32)
    missed: wp.array(dtype=wp.int32)  # (1) voxels that were given an infinite distance, to be searched for later
    # Of each voxel what its distance is from, see `dense.block.winners`; without elements if nobody wants to know.
    winners: wp.array(dtype=wp.int32)
    searched: wp.array(dtype=wp.int32)  # (1) with winners: 1 if there are any of searched triangles


@wp.func_native(
    snippet="""
    return elsewhere ? (wp::uint64)address.data[0] : (wp::uint64)values.data;
"""
)
def _choose(values: wp.array(dtype=wp.float32), elsewhere: int, address: wp.array(dtype=wp.int64)) -> wp.uint64: ...


@wp.func
def distances_at(out: Output):
    """The address of the distances."""
    return _choose(out.values, out.elsewhere, out.address)


@wp.func_native(snippet="return reinterpret_cast<const float*>(address)[index];")
def read_distance(address: wp.uint64, index: int) -> float: ...


@wp.func_native(snippet="reinterpret_cast<float*>(address)[index] = distance;")
def put_distance(address: wp.uint64, index: int, distance: float): ...


@wp.func
def with_sign(distance: float, winding: float):
    """A signed distance: negative where the winding number says inside."""
    return wp.where(winding > 0.5, -distance, distance)


@wp.func
def is_unclear(winding: float):
    """1 if a winding number hardly tells inside from outside."""
    return wp.where(wp.abs(winding - 0.5) < 0.25, 1, 0)


@wp.func
def write_distance(out: Output, index: int, distance: float):
    """Write a voxel's signed distance; 1 if its winding number was unclear."""
    winding = out.values[index]
    put_distance(distances_at(out), index, with_sign(distance, winding))
    return is_unclear(winding)
