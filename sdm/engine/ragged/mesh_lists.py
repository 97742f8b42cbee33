"""Lists of meshes and of what is asked of each: taken one by one, with the mesh's number in front of every error."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import repeat
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.engine.repeated_faces import CROWDED
from sdm.errors import GridError, MeshError, SDMError
from sdm.runtime.operators import is_eager
from sdm.runtime.torch_warp import refuse_other_modes

T = TypeVar("T")

# Parts of a batch of vertices.
_ARRAYS = (Tensor, np.ndarray, list, int, float, np.number)
# What is gone through otherwise than as meshes one by one, and by what arrays and meshes of other libraries are known.
_SINGLE = (str, bytes, os.PathLike, TriangleMesh, Tensor, np.ndarray)
_SINGLE_HAS = ("__array__", "__array_interface__", "__dlpack__", "vertices", "points")
_END: Any = object()
_WANTED = "give one grid, or one for each mesh"


def are_meshes(given: Any) -> bool:
    """True for meshes in a list, or one by one from an iterable, and not for arrays that are a batch of vertices.

    A batch of PyTorch3D or Kaolin is a list too: see `as_sequence`.
    """
    if isinstance(given, list | tuple):
        return not given or any(not isinstance(each, _ARRAYS) for each in given if not _is_row(each))
    if hasattr(given, "faces_list") or hasattr(given, "batching"):
        return True
    if not isinstance(given, Iterable) or isinstance(given, _SINGLE):
        return False
    return isinstance(given, Iterator) or not any(hasattr(given, name) for name in _SINGLE_HAS)


def _is_row(each: Any) -> bool:
    # A pair may be (vertices, faces); other tuples are rows of nested ones.
    return isinstance(each, tuple) and len(each) != 2


def as_sequence(given: Any) -> Any:
    """The meshes of an iterable in a list, those of another library's batch as (vertices, faces); an iterator as is."""
    if hasattr(given, "faces_list"):
        return list(zip(given.verts_list(), given.faces_list(), strict=True))
    if hasattr(given, "batching"):
        vertices, faces = given.vertices, given.faces
        if not isinstance(vertices, list | tuple) and vertices.ndim == 2:
            return [(vertices, faces)]
        is_shared = not isinstance(faces, list | tuple) and faces.ndim == 2
        return list(zip(vertices, [faces] * len(vertices) if is_shared else faces, strict=True))
    if not isinstance(given, Iterable) or isinstance(given, _SINGLE):
        raise MeshError(f"an object of type {type(given).__name__} is no list of meshes: give them in one, [mesh]")
    return list(given) if are_meshes(given) and not isinstance(given, list | tuple | Iterator) else given


def is_crowded(mesh: TriangleMesh) -> bool:
    """True for a mesh of copies of few triangles, on the host."""
    return mesh.device.type == "cpu" and len(mesh) >= CROWDED * mesh.vertices.shape[0]


def is_plain(mesh: TriangleMesh) -> bool:
    """True for a mesh that no gradients flow to, with nothing else of torch's in the way."""
    refuse_other_modes(mesh.vertices)
    return is_eager(mesh.vertices)


def numbered(number: int, make: Callable[[], T]) -> T:
    """The result of `make`, whose errors name the mesh with this number, counted from 0.

    Raises:
        SDMError: As `make` raises it.
    """
    try:
        return make()
    except SDMError as error:
        raise type(error)(f"mesh {number}: {error}") from error


def each_mesh(meshes: Iterable[MeshLike]) -> Iterator[tuple[int, TriangleMesh]]:
    """The meshes and their numbers, each made as it is asked for.

    Raises:
        MeshError: One that is none.
    """
    for number, mesh in enumerate(meshes):
        yield number, mesh if isinstance(mesh, TriangleMesh) else numbered(number, partial(as_mesh, mesh))


def each_grid(meshes: Iterable[MeshLike], grids: Any) -> Iterator[Any]:
    """A grid, or what stands for one, for each mesh: those of a list or an iterator of them, or the same for all.

    Raises:
        GridError: As many grids as meshes are needed, and there are others, or numbers that are no resolution.
    """
    if isinstance(grids, list | tuple) and not all(isinstance(grid, int | float | np.number) for grid in grids):
        if isinstance(meshes, list | tuple) and len(meshes) != len(grids):
            raise GridError(f"{len(meshes)} meshes and {len(grids)} grids were given: {_WANTED}")
    elif isinstance(grids, list | tuple) and len(grids) not in (0, 3):
        raise GridError(
            f"the numbers {grids} are no grid: give one, or three, one for each axis, or for each mesh a Grid or three "
            "numbers"
        )
    elif not isinstance(grids, Iterator):
        return repeat(grids)
    return iter(grids)


def each_points(meshes: Iterable[MeshLike], points: Any) -> Iterator[Any]:
    """Points for each mesh: one set of a list, a batch or an iterator each.

    Raises:
        MeshError: As many as meshes are needed, and there are others.
    """
    if isinstance(meshes, list | tuple) and hasattr(points, "__len__") and len(meshes) != len(points):
        raise MeshError(f"{len(meshes)} meshes and {len(points)} sets of points were given: give one for each mesh")
    if not isinstance(points, Iterable):
        raise MeshError(f"an object of type {type(points).__name__} holds no points: give a set of them for each mesh")
    return iter(points)


def in_pairs(meshes: Iterable[MeshLike], others: Iterator[T], what: str) -> Iterator[tuple[int, TriangleMesh, T]]:
    """The meshes with their numbers, each with what is asked of it: both are taken as they are needed.

    Raises:
        MeshError: One that is none, or more or fewer than of `what`.
    """
    number = -1
    for number, mesh in each_mesh(meshes):
        other = next(others, _END)
        if other is _END:
            raise MeshError(f"{what} ended before mesh {number}: give one for each mesh")
        yield number, mesh, other
    if not isinstance(others, repeat) and next(others, _END) is not _END:
        raise MeshError(f"{number + 1} meshes came, and more {what}: give one for each mesh")
