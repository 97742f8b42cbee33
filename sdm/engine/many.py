"""Exact signed distances to many meshes: of a batch that shares its faces, or of meshes that differ."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Literal, Unpack, overload

import torch
from jaxtyping import Float32, Int32
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.as_mesh import MeshLike
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.signed_distance_map import SDM
from sdm.engine.acceleration import build
from sdm.engine.api import signed_distance, signed_distance_map
from sdm.engine.arguments import (
    WINDING,
    BatchOptions,
    ListOptions,
    Orient,
    PointListOptions,
    Sign,
    SignMethod,
    check_orient,
)
from sdm.engine.checks.values_check import batch_checks, look_at_batch
from sdm.engine.closest_points import Closest
from sdm.engine.map_closest import VOXEL_BYTES, closest_map
from sdm.engine.maps import batch_maps
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.points import check_sign_at_points
from sdm.engine.ragged.calls import Found, Wanted, maps_of
from sdm.engine.ragged.mesh_lists import are_meshes, as_sequence
from sdm.engine.ragged.point_calls import distances_of
from sdm.errors import MeshError, SDMError
from sdm.runtime.torch_warp import refuse_other_modes
from sdm.topology.face_pairing import neighbours


@overload
def signed_distances(
    meshes: list[MeshLike] | tuple[MeshLike, ...],
    points: Any,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[PointListOptions],
) -> list[Tensor]: ...
@overload
def signed_distances(
    meshes: list[MeshLike] | tuple[MeshLike, ...],
    points: Any,
    *,
    return_closest: Literal[True],
    **options: Unpack[PointListOptions],
) -> list[tuple[Tensor, Closest]]: ...
@overload
def signed_distances(
    meshes: Iterator[MeshLike],
    points: Any,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[PointListOptions],
) -> Iterator[Tensor]: ...
@overload
def signed_distances(
    meshes: Iterator[MeshLike],
    points: Any,
    *,
    return_closest: Literal[True],
    **options: Unpack[PointListOptions],
) -> Iterator[tuple[Tensor, Closest]]: ...
def signed_distances(
    meshes: Iterable[MeshLike],
    points: Any,
    *,
    return_closest: bool = False,
    device: str | torch.device | None = None,
    sign: Sign = "winding",
    max_bytes: int | None = None,
) -> list[Any] | Iterator[Any]:
    """Exact signed distances of points from many meshes: of each mesh its own points.

    Args:
        meshes: Any meshes, in a list or another iterable, or an iterator of them.
        points: For each mesh (...,3) coordinates, as `signed_distance` takes them: a list, an iterator, or (B,N,3).
        return_closest: Also return where the closest points are: a pair for each mesh.
        device: Where to compute; by default of each mesh as in `signed_distance`.
        sign: `"winding"`, or `"none"` for distances of at least 0.
        max_bytes: Memory for the meshes that are built and asked together, by default 1/24 of a GPU's.

    Returns:
        For each mesh what `signed_distance` gives, bit for bit: a list, or of an iterator an iterator, which takes as
        many meshes as it needs for the next chunk.

    Raises:
        DeviceError: The device is not there.
        MeshError: One is no mesh, or one that cannot be used: its number, from 0, comes first. Or there are not as many
            sets of points as meshes.
        SDMError: A sign that there is not for points.
    """
    check_sign_at_points(sign)
    meshes = as_sequence(meshes)
    single: Any = partial(_distance_there, return_closest=return_closest, sign=sign)
    found = distances_of(meshes, points, single, return_closest, sign, device=device, max_bytes=max_bytes)
    return found if isinstance(meshes, Iterator) else list(found)


@overload
def signed_distance_maps(
    vertices: list[MeshLike] | tuple[MeshLike, ...],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[ListOptions],
) -> list[SDM]: ...
@overload
def signed_distance_maps(
    vertices: list[MeshLike] | tuple[MeshLike, ...],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    return_closest: Literal[True],
    **options: Unpack[ListOptions],
) -> list[tuple[SDM, Closest]]: ...
@overload
def signed_distance_maps(
    vertices: Iterator[MeshLike],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[ListOptions],
) -> Iterator[SDM]: ...
@overload
def signed_distance_maps(
    vertices: Iterator[MeshLike],
    faces: GridLike | Sequence[Grid] | Iterator[Grid] | None = None,
    /,
    *,
    return_closest: Literal[True],
    **options: Unpack[ListOptions],
) -> Iterator[tuple[SDM, Closest]]: ...
@overload
def signed_distance_maps(
    vertices: Any,
    faces: Any,
    grid: GridLike | None = None,
    *,
    return_closest: Literal[False] = False,
    **options: Unpack[BatchOptions],
) -> Float32[Tensor, "b nx ny nz"]: ...
@overload
def signed_distance_maps(
    vertices: Any,
    faces: Any,
    grid: GridLike | None = None,
    *,
    return_closest: Literal[True],
    **options: Unpack[BatchOptions],
) -> tuple[Float32[Tensor, "b nx ny nz"], Closest]: ...
def signed_distance_maps(
    vertices: Any,
    faces: Any = None,
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
    max_bytes: int | None = None,
) -> Any:
    """The exact signed distance maps of many meshes: of a batch that shares its faces, or of any meshes in a list.

    Args:
        vertices: (B,V,3) float32, one mesh each. Not checked for NaN: that would wait for the device.
        faces: (F,3) int32.
        grid: The voxel centres to measure at, the same for all, or voxels along each axis of a cube around all.
        resolution: That number, by name.
        margin: Room in that cube, as for `signed_distance_map`.
        device: Where to compute; by default where the vertices are if they are a tensor, else a GPU if there is one.
        orient: As for `signed_distance_map`; of a batch the faces stay as they are.
        sign: As there.
        hole_size: Of a flood.
        compare_signs: As there, of meshes that differ.
        return_closest: Also return where the closest points are.
        max_bytes: Of meshes that differ, see below.

    Returns:
        (B,nx,ny,nz) float32, negative inside. Differentiable in `vertices`. Recorded and replayed as
        `signed_distance_map`. With `return_closest` also a `Closest` of all: points (B,nx,ny,nz,3), ...

    Meshes that differ: `signed_distance_maps([mesh, ...], grid)`, also of a batch of PyTorch3D or Kaolin, with one
    grid, one for each mesh, or voxels along each axis of a cube around each, gives a list of maps, each bit for bit
    that of `signed_distance_map` with the same options; with `return_closest` a list of pairs (SDM, Closest). Meshes
    are built and measured together, as many at a time as fit into `max_bytes` beside their maps, by default 1/24 of a
    GPU's memory; floods, closest points and the turning of faces are done mesh by mesh. An iterator of meshes gives an
    iterator of maps, which takes as many meshes as it needs for the next chunk, and the same of grids; any other
    iterable a list. The maps of a chunk are parts of one tensor. Errors and warnings name the mesh by its number,
    from 0. Of a batch the first maps of faces on a grid are looked at, and there is a warning if nothing is inside one
    of them since it is elsewhere or inside out; on a GPU at the next call, as nothing waits for it.

    Raises:
        DeviceError: The device is not there.
        GridError: The maps do not fit into memory, or nothing says what their grid is.
        MeshError: What is given is no batch and no list of meshes, or one of them cannot be used.
        SDMError: A sign that there is not, or an option that is for single meshes and lists alone.
    """
    plain = sign == "winding" and hole_size is None and not compare_signs
    method = WINDING if plain else SignMethod(sign, hole_size, compare_signs)
    if orient != "keep":
        check_orient(orient)
    if not isinstance(grid, Grid) and are_meshes(vertices):
        meshes = as_sequence(vertices)
        single = partial(
            _map_there, sign=sign, hole_size=hole_size, compare_signs=compare_signs, return_closest=return_closest
        )
        options = {"resolution": resolution, "margin": margin, "device": device, "max_bytes": max_bytes}
        wanted = Wanted(method, orient, return_closest)
        maps = maps_of(meshes, faces if grid is None else grid, single, wanted, **options)
        return maps if isinstance(meshes, Iterator) else list(maps)
    if isinstance(vertices, TriangleMesh | str | os.PathLike):
        raise MeshError("many meshes are wanted: give them in a list, [mesh], or one to sdm.signed_distance_map")
    if orient != "keep" or compare_signs:
        what = f"orient={orient!r}" if orient != "keep" else "compare_signs=True"
        raise SDMError(f"{what} is for single meshes and lists of them, not for a batch that shares its faces")
    where = choose_device(device, vertices if isinstance(vertices, Tensor) else None)
    batch, shared = vertices, faces
    # A stream's are as they should be, batch after batch.
    if not (isinstance(batch, Tensor) and batch.dtype == torch.float32 and batch.device == where):
        batch = as_tensor(vertices, torch.float32, "the vertices", device=where)
    if not (isinstance(shared, Tensor) and shared.dtype == torch.int32 and shared.device == where):
        shared = as_tensor(faces, torch.int32, "the faces", device=where)
    refuse_other_modes(batch)
    if batch.ndim != 3 or batch.shape[2] != 3 or batch.shape[0] == 0:
        raise MeshError(f"the vertices have shape {tuple(batch.shape)}; (B, V, 3) is needed")
    if shared.ndim != 2 or shared.shape[1] != 3 or shared.shape[0] == 0:
        raise MeshError(f"the faces have shape {tuple(shared.shape)}; (F, 3) with F > 0 is needed")
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, _box_of(batch, shared), resolution, margin)
    nbytes = (VOXEL_BYTES if return_closest else 4) * batch.shape[0] * math.prod(grid.shape)
    with memory_guard(nbytes, where, f"{batch.shape[0]} maps"):
        values = _flooded(batch, shared, grid, hole_size) if sign == "flood" else batch_maps(batch, shared, grid, None)
        values = values.abs() if sign == "none" else values
        seen = batch_checks.get(shared)
        if seen is None or seen.grid is not grid or seen.found is not None:
            look_at_batch(batch, shared, grid, values, sign)
        return (values, _closest(batch, shared, grid, values)) if return_closest else values


def _distance_there(mesh: TriangleMesh, points: Any, device: torch.device, **options: Any) -> Any:
    return signed_distance(mesh, points, device=device, **options)


def _map_there(mesh: TriangleMesh, grid: Grid, device: torch.device, **options: Any) -> Found:
    return signed_distance_map(mesh, grid, device=device, **options)


def _flooded(batch: Tensor, faces: Tensor, grid: Grid, hole_size: float | None) -> Tensor:
    fields = [
        MeshIndex(TriangleMesh(vertices, faces, check=False), batch.device, warn=False).signed_distance_map(
            grid, sign="flood", hole_size=hole_size
        )
        for vertices in batch
    ]
    return torch.stack([field.values for field in fields])


def _closest(batch: Tensor, faces: Tensor, grid: Grid, values: Tensor) -> Closest:
    """Closest points of a batch, whose maps are there."""
    placed, faces = batch.detach().contiguous(), faces.contiguous()
    structure, around = build(placed, faces), neighbours(faces, placed.shape[1])
    meshes = [TriangleMesh(vertices, faces, check=False) for vertices in placed]
    found = [
        closest_map(mesh, structure.of_mesh(i), grid, known=values[i].detach(), around=around)
        for i, mesh in enumerate(meshes)
    ]
    _, _, points, named, barycentric = (torch.stack(parts) for parts in zip(*found, strict=True))
    return Closest(points, named, barycentric, meshes[0], grid, len(meshes))


def _box_of(batch: Float32[Tensor, "b v 3"], faces: Int32[Tensor, "f 3"]) -> TriangleMesh:
    """A triangle with the box of a batch of meshes."""
    used = batch.detach()[:, faces.reshape(-1).long()]
    low, high = used.amin((0, 1)), used.amax((0, 1))
    return TriangleMesh(torch.stack([low, high, low]), [[0, 1, 2]], "the batch")
