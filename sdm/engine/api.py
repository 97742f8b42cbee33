"""Exact signed distances to triangle meshes: the functions that most users call."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal, cast, overload

import torch
from jaxtyping import Float32
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.signed_distance_map import SDM
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.arguments import UNSIGNED, Orient, Sign, SignMethod, described, oriented, refuse_forward_mode
from sdm.engine.closest_points import Closest
from sdm.engine.map_check import MapCheck, checked
from sdm.engine.maps import batch_maps, is_recordable, mesh_map, unsigned_mesh_map
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.mesh_lists import are_meshes, box_of, each_of
from sdm.engine.points import at_points
from sdm.engine.ragged.calls import distances_of, maps_of
from sdm.engine.repeated_faces import may_be_crowded
from sdm.errors import MeshError
from sdm.runtime.operators import is_eager
from sdm.topology.boundary_edges import boundary_edges


@overload
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
    return_closest: Literal[False] = False,
) -> SDM: ...
@overload
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
    return_closest: Literal[True],
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
    slices are thick (`sdm.engine.thick_slices`); on a GPU 150 to 600 MiB for meshes of up to 100,000 triangles, more
    for finer ones, at most a 14th of the GPU's memory and 4.5 GiB. Maps larger than memory: `MeshIndex.slabs`. On a GPU
    calls of one kind are recorded and replayed, which keeps some of that memory: see `sdm.runtime.graphs`.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, mesh, resolution, margin)
    where = choose_device(device, mesh.vertices)
    method = SignMethod(sign, hole_size, compare_signs)
    measured = oriented(mesh, orient, where)
    mesh = measured.to(where)
    if return_closest:
        index = MeshIndex(mesh, where, warn=False)
        field, hit = index.signed_distance_map(
            grid, sign=sign, hole_size=hole_size, compare_signs=compare_signs, return_closest=True
        )
        return checked(MapCheck(), field, measured if index._repeated is None else index._measured), hit
    if method == UNSIGNED and is_recordable(mesh.vertices, grid.nbytes):
        refuse_forward_mode(mesh.vertices)
        with memory_guard(grid.nbytes, mesh.device, described(grid)):
            field = SDM(unsigned_mesh_map(mesh.vertices, mesh.faces, grid), grid, sign="none")
    elif method.is_default and is_recordable(mesh.vertices, grid.nbytes):
        refuse_forward_mode(mesh.vertices)
        with memory_guard(grid.nbytes, mesh.device, described(grid)):
            values, ambiguous = mesh_map(mesh.vertices, mesh.faces, grid)
        field = SDM(values, grid, 0 if ambiguous is None else int(ambiguous), sign="winding")
    else:
        index = MeshIndex(mesh, where, warn=False)
        field = index.signed_distance_map(grid, sign=sign, hole_size=hole_size, compare_signs=compare_signs)
        # Copies of a triangle are looked at once.
        measured = measured if index._repeated is None else index._measured
    return checked(MapCheck(), field, measured)


@overload
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: Literal[False] = False,
    device: str | torch.device | None = None,
    sign: Sign = "winding",
) -> Tensor: ...
@overload
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: Literal[True],
    device: str | torch.device | None = None,
    sign: Sign = "winding",
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
        device: Where to compute; by default where the points are if they are a tensor, else a GPU if there is one.
        sign: `"winding"`, or `"none"` for distances of at least 0. A flood needs a grid, so `"flood"` is refused.

    Returns:
        (...) float32, negative inside, as exact as `signed_distance_map`; NaN where a point is not finite.
        Differentiable in `points` and in `mesh.vertices`: the gradient at a point is the outward direction, at a vertex
        minus the closest point's barycentric coordinate times that direction. With `return_closest` also a `Closest`.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    refuse_forward_mode(mesh.vertices)
    where = choose_device(device, points if isinstance(points, Tensor) else None, mesh.vertices)
    placed = mesh.to(where)
    structure = None
    if where.type == "cpu" and is_eager(placed.vertices.detach()):
        edges = boundary_edges(placed.vertices, placed.faces)
        if may_be_crowded(placed, edges):
            index = MeshIndex(placed, where, warn=False)
            return at_points(
                index._measured, points, return_closest, index._structure, index._repeated, index.mesh, sign
            )
        if sign == "winding":
            structure = build(placed.vertices.detach()[None], placed.faces, edges)
    return at_points(placed, points, return_closest, structure, sign=sign)


@overload
def signed_distances(
    meshes: list[MeshLike] | tuple[MeshLike, ...],
    points: Any,
    *,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> list[Tensor]: ...
@overload
def signed_distances(
    meshes: Iterator[MeshLike],
    points: Any,
    *,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> Iterator[Tensor]: ...
def signed_distances(
    meshes: Iterable[MeshLike],
    points: Any,
    *,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> list[Tensor] | Iterator[Tensor]:
    """Exact signed distances of points from many meshes: of each mesh its own points.

    Args:
        meshes: Any meshes, in a list, or an iterator of them.
        points: For each mesh (...,3) coordinates, as `signed_distance` takes them: a list, an iterator, or (B,N,3).
        device: Where to compute; by default of each mesh as in `signed_distance`.
        max_bytes: Memory for the meshes that are built together, by default 1/24 of a GPU's.

    Returns:
        For each mesh what `signed_distance` gives, bit for bit: a list, or of an iterator an iterator, which takes as
        many meshes as it needs for the next chunk.

    Raises:
        DeviceError: The device is not there.
        MeshError: One is no mesh, or one that cannot be used: its number, from 0, comes first. Or there are not as many
            sets of points as meshes.
    """

    def single(mesh: TriangleMesh, at: Any, structure: AccelerationStructure | None) -> Tensor:
        # Without the closest points it is one tensor.
        return cast(Tensor, at_points(mesh, at, False, structure))

    meshes = each_of(meshes)
    found = distances_of(meshes, points, single, device=device, max_bytes=max_bytes)
    return found if isinstance(meshes, Iterator) else list(found)


@overload
def signed_distance_maps(
    vertices: list[MeshLike] | tuple[MeshLike, ...],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> list[SDM]: ...
@overload
def signed_distance_maps(
    vertices: Iterator[MeshLike],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> Iterator[SDM]: ...
@overload
def signed_distance_maps(
    vertices: Any,
    faces: Any,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
) -> Float32[Tensor, "b nx ny nz"]: ...
def signed_distance_maps(
    vertices: Any,
    faces: Any = None,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
    max_bytes: int | None = None,
) -> Float32[Tensor, "b nx ny nz"] | list[SDM] | Iterator[SDM]:
    """The exact signed distance maps of many meshes: of a batch that shares its faces, or of any meshes in a list.

    Args:
        vertices: (B,V,3) float32, one mesh each. Not checked for NaN: that would wait for the device.
        faces: (F,3) int32.
        grid: The voxel centres to measure at, the same for all, or voxels along each axis of a cube around all.
        resolution: That number, by name.
        margin: Room in that cube, as for `signed_distance_map`.
        device: Where to compute; by default where the vertices are if they are a tensor, else a GPU if there is one.
        max_bytes: Of meshes that differ, see below.

    Returns:
        (B,nx,ny,nz) float32, negative inside. Differentiable in `vertices`. Recorded and replayed as
        `signed_distance_map`.

    Meshes that differ: `signed_distance_maps([mesh, ...], grid)`, also of a batch of PyTorch3D or Kaolin, with one
    grid, one for each mesh, or voxels along each axis of a cube around each, gives a list of maps, each bit for bit
    that of `signed_distance_map`. Meshes are built and measured together, as many at a time as fit into `max_bytes`
    beside their maps, by default 1/24 of a GPU's memory. An iterator of meshes gives an iterator of maps, which takes
    as many meshes as it needs for the next chunk, and the same of grids. The maps of a chunk are parts of one tensor.
    Errors name the mesh by its number, from 0.
    """
    if not isinstance(grid, Grid) and are_meshes(vertices):
        options = {"resolution": resolution, "margin": margin, "device": device, "max_bytes": max_bytes}
        vertices = each_of(vertices)
        maps = maps_of(vertices, faces if grid is None else grid, _map_there, **options)
        return list(maps) if isinstance(vertices, list | tuple) else maps
    where = choose_device(device, vertices if isinstance(vertices, Tensor) else None)
    batch, shared = vertices, faces
    # A stream's are as they should be, batch after batch.
    if not (isinstance(batch, Tensor) and batch.dtype == torch.float32 and batch.device == where):
        batch = as_tensor(vertices, torch.float32, "the vertices", device=where)
    if not (isinstance(shared, Tensor) and shared.dtype == torch.int32 and shared.device == where):
        shared = as_tensor(faces, torch.int32, "the faces", device=where)
    refuse_forward_mode(batch)
    if batch.ndim != 3 or batch.shape[2] != 3 or batch.shape[0] == 0:
        raise MeshError(f"the vertices have shape {tuple(batch.shape)}; (B, V, 3) is needed")
    if shared.ndim != 2 or shared.shape[1] != 3 or shared.shape[0] == 0:
        raise MeshError(f"the faces have shape {tuple(shared.shape)}; (F, 3) with F > 0 is needed")
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, box_of(batch, shared), resolution, margin)
    with memory_guard(4 * batch.shape[0] * math.prod(grid.shape), where, f"{batch.shape[0]} maps"):
        return batch_maps(batch, shared, grid, None)


def _map_there(mesh: TriangleMesh, grid: Grid) -> SDM:
    return signed_distance_map(mesh, grid, device=mesh.device)
