"""Exact signed distances to triangle meshes: the functions that most users call."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, Unpack, overload

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import SHARE_UNASKED, SMALL, choose_device, memory_guard, total_memory
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine import maps
from sdm.engine.acceleration import build
from sdm.engine.arguments import (
    UNSIGNED,
    WINDING,
    MapOptions,
    Orient,
    PointOptions,
    Sign,
    SignMethod,
    described,
    oriented,
)
from sdm.engine.capacity.ready_maps import ready_map
from sdm.engine.checks.map_check import MapCheck, checked, one_check
from sdm.engine.checks.values_check import look_at_points
from sdm.engine.closest_points import Closest
from sdm.engine.maps import is_recordable, mesh_map, unsigned_mesh_map
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.points import at_points, search_needs_tree_alone
from sdm.engine.repeated_faces import may_be_crowded
from sdm.runtime import graphs
from sdm.runtime.operators import is_eager
from sdm.runtime.torch_warp import current_device, has_forward_mode, refuse_other_modes
from sdm.topology.boundary_edges import boundary_edges


@overload
def signed_distance_map(
    mesh: MeshLike,
    grid: GridLike | None = None,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[MapOptions],
) -> SDM: ...
@overload
def signed_distance_map(
    mesh: MeshLike,
    grid: GridLike | None = None,
    *,
    return_closest: Literal[True],
    **options: Unpack[MapOptions],
) -> tuple[SDM, Closest]: ...
def signed_distance_map(
    mesh: MeshLike,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
    orient: Orient = "keep",
    sign: Sign = "winding",
    hole_size: float | None = None,
    compare_signs: bool = False,
    return_closest: bool = False,
) -> SDM | tuple[SDM, Closest]:
    """The exact signed distance map of a mesh on a grid.

    Args:
        mesh: Any triangles: closed or not, with slivers, zero-area and repeated faces. A `TriangleMesh`, to whose
            vertices gradients flow, or whatever `sdm.core.as_mesh` takes for one: a path, (vertices, faces), a mesh of
            another library.
        grid: The voxel centres to measure at: a `Grid`, voxels along each axis of a cube around the mesh, an image of
            another library or the path of one, see `sdm.core.as_grid`.
        resolution: That number, by name.
        margin: Room around the mesh in that cube, as a share of the longest edge of the mesh's box; 0.05 by default.
        device: Where to compute; by default a GPU if there is one. The values stay there.
        orient: `"auto"` makes faces agree and turns parts that are inside out, see `sdm.inspect.orient_outward`;
            `"parts"` turns every patch of faces outward by what sees it from outside, see `sdm.orient_faces`; `"keep"`
            takes every mesh as it is.
        sign: `"winding"`, the generalised winding number, which needs faces that agree; `"flood"`, inside is what a
            ball from outside cannot reach, whatever the faces say: for sheets and soups of triangles; `"none"`, no
            sign: distances of at least 0. `MeshReport.recommended_sign` recommends one.
        hole_size: Of `"flood"`, the ball's diameter, in the mesh's unit: gaps that are narrower are closed. By default
            two of the grid's longest voxel edges.
        compare_signs: Also count the voxels on which winding numbers and a flood disagree:
            `SDM.sign_disagreements`.
        return_closest: Also return where the closest points are: 28 more bytes a voxel.

    Returns:
        The map, negative inside: every value is the distance to the closest point over all triangles, to within
        4 roundings of float32 at the scale of the coordinates, with the sign of the generalised winding number
        (more than 0.5 is inside). Inside is not well defined for open sheets: `ambiguous_voxels` counts where the
        winding number is within 0.25 of 0.5. By `"flood"` a closed mesh without cavities has the same map, bit for
        bit, unless a place outside is shut off by gaps hardly wider than `hole_size`; inside is a cavity too, and what
        an open mesh encloses. Of a mesh that reaches beyond the grid the flood sees all. The flood takes 4 to 8 bytes a
        voxel more; its definition is in `bench/decisions/0027-signs-by-a-flood.md`.

        With `return_closest` also a `Closest` of each voxel's closest point, (nx,ny,nz,3), its face and its barycentric
        coordinates there, without gradients; the values are the same.

    Raises:
        DeviceError: The device is not there.
        GridError: The map does not fit into memory, or nothing says what its grid is.
        MeshError: What is given is no mesh, or one that cannot be used.
        SDMError: A sign that there is not, or a `hole_size` that makes no sense.

    Warns:
        SDMWarning: The map is probably not what was meant: a mesh or a part of it inside out, faces that disagree, no
            volume, or a box outside the grid, as of LPS coordinates or another unit. On a GPU when something of the
            map is first read on the host; never for maps that gradients flow through.

    Memory beyond the map itself: about 350 bytes a triangle, and scratch: 100 MiB on a CPU, and up to 128 more where
    slices are thick (`sdm.engine.thick_slices`); on a GPU 150 to 510 MiB for meshes of up to 100,000 triangles, more
    for finer ones, at most a 14th of the GPU's memory and 4.5 GiB. Maps larger than memory: `MeshIndex.slabs`. On a GPU
    calls of one kind are recorded and replayed, which keeps some of that memory: see `sdm.runtime.graphs`.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, mesh, resolution, margin)
    as_it_is = sign == "winding" and orient == "keep" and hole_size is None and not (compare_signs or return_closest)
    if as_it_is and mesh.vertices.is_cuda:
        field = _plain_map(mesh, grid, device)
        if field is not None:
            return field
    where = choose_device(device, mesh.vertices)
    plain = sign == "winding" and hole_size is None and not compare_signs
    method = WINDING if plain else SignMethod(sign, hole_size, compare_signs)
    measured = oriented(mesh, orient, where)
    mesh = measured.to(where)
    if return_closest:
        index = MeshIndex(mesh, where, warn=False)
        field, hit = index.signed_distance_map(
            grid, sign=sign, hole_size=hole_size, compare_signs=compare_signs, return_closest=True
        )
        return checked(MapCheck(), field, measured if index._repeated is None else index._measured), hit
    nbytes = grid.nbytes
    if not (method.is_default or method == UNSIGNED) or not is_recordable(mesh.vertices, nbytes):
        index = MeshIndex(mesh, where, warn=False)
        field = index.signed_distance_map(grid, sign=sign, hole_size=hole_size, compare_signs=compare_signs)
        # Copies of a triangle are looked at once.
        return checked(MapCheck(), field, measured if index._repeated is None else index._measured)
    refuse_other_modes(mesh.vertices)
    with memory_guard(nbytes, where, partial(described, grid)):
        if method.is_default:
            field, ambiguous = mesh_map(
                mesh.vertices, mesh.faces, grid, partial(SDM, grid=grid, ambiguous_voxels=0, sign="winding")
            )
        else:
            ambiguous = None
            field = SDM(unsigned_mesh_map(mesh.vertices, mesh.faces, grid), grid, sign="none")
    if ambiguous is not None:
        # Of an open mesh the host does not wait either.
        field.counted_later(ambiguous)
    return checked(MapCheck(), field, measured)


def _plain_map(mesh: TriangleMesh, grid: Grid, device: str | torch.device | None) -> SDM | None:
    """The map by winding numbers of a mesh on a GPU as it is, by what replays or records a call, and no more.

    Until the first kernel is launched a GPU waits for the host, which for a small map takes as long as the kernels.
    None of a mesh elsewhere, with derivatives, and of a large map.
    """
    vertices, faces = mesh.vertices, mesh.faces
    x, y, z = grid.shape
    nbytes = 4 * x * y * z
    if has_forward_mode() or not graphs.supports(vertices):
        return None
    if nbytes > SMALL and nbytes > min(maps.LARGEST_RECORDED, total_memory(vertices.device) // SHARE_UNASKED):
        return None
    # "cuda" is the current one. To compare a name with a device takes the host longer than to ask for its number.
    index = vertices.get_device()
    if device == "cuda":
        if index != current_device():
            return None
    elif device is not None and device != vertices.device:
        return None

    def make(values: Tensor) -> SDM:
        return SDM.on_gpu(values, grid, sign="winding", check=one_check(mesh, "winding"))

    try:
        found, tried = ready_map(vertices, faces, grid, index, make) if maps.USE_CLASSES else (None, None)
        field, ambiguous = found or mesh_map(vertices, faces, grid, make, tried)
    except torch.OutOfMemoryError:
        with memory_guard(nbytes, vertices.device, partial(described, grid)):
            raise
    return field if ambiguous is None else field.counted_later(ambiguous)


@overload
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[PointOptions],
) -> Tensor: ...
@overload
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: Literal[True],
    **options: Unpack[PointOptions],
) -> tuple[Tensor, Closest]: ...
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: bool = False,
    device: str | torch.device | None = None,
    sign: Sign = "winding",
) -> Tensor | tuple[Tensor, Closest]:
    """Exact signed distances of points from a mesh.

    Args:
        mesh: Any triangles, as `signed_distance_map` takes them.
        points: (...,3) coordinates in the mesh's unit, NumPy or torch, taken as float32.
        return_closest: Also return where the closest points are.
        device: Where to compute, and where the result is; by default the GPU that the points or the mesh are on, else a
            GPU if there is one.
        sign: `"winding"`, or `"none"` for distances of at least 0. A flood needs a grid, so `"flood"` is refused.

    Returns:
        (...) float32, negative inside, as exact as `signed_distance_map`; NaN where a point is not finite.
        Differentiable in `points` and in `mesh.vertices`: the gradient at a point is the outward direction, at a vertex
        minus the closest point's barycentric coordinate times that direction. With `return_closest` also a `Closest`.

    Raises:
        DeviceError: The device is not there.
        MeshError: What is given is no mesh, or one that cannot be used, or the points are not (...,3) numbers.
        SDMError: A sign that there is not for points.

    Warns:
        SDMWarning: On a CPU, none of 8 points or more is inside, and the mesh would be among them in other axes or
            another unit, or it is inside out.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    refuse_other_modes(mesh.vertices)
    where = choose_device(device, points if isinstance(points, Tensor) else None, mesh.vertices)
    placed = mesh.to(where)
    structure = None
    if where.type == "cpu" and is_eager(placed.vertices.detach()):
        edges = boundary_edges(placed.vertices, placed.faces)
        if may_be_crowded(placed, edges):
            return MeshIndex(placed, where).signed_distance(points, return_closest=return_closest, sign=sign)
        if sign == "winding":
            alone = search_needs_tree_alone(where)
            structure = build(placed.vertices.detach()[None], placed.faces, edges, tree_alone=alone)
    found = at_points(placed, points, return_closest, structure, sign=sign)
    look_at_points(placed, points, found, sign)
    return found
