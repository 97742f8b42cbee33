"""Lists of meshes and of what is asked of each: taken one by one, with the mesh's number in front of every error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import repeat
from typing import Any, TypeVar

import numpy as np

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.errors import GridError, MeshError, SDMError

T = TypeVar("T")

_END: Any = object()
_WANTED = "give one grid, or one for each mesh"


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
        yield number, numbered(number, lambda mesh=mesh: as_mesh(mesh))


def each_grid(meshes: Iterable[MeshLike], grids: Any) -> Iterator[Any]:
    """A grid, or what stands for one, for each mesh: those of a list or an iterator of them, or the same for all.

    Raises:
        GridError: As many grids as meshes are needed, and there are others.
    """
    if isinstance(grids, list | tuple) and not all(isinstance(grid, int | float | np.number) for grid in grids):
        if isinstance(meshes, list | tuple) and len(meshes) != len(grids):
            raise GridError(f"{len(meshes)} meshes and {len(grids)} grids were given: {_WANTED}")
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
    return iter(points)


def in_pairs(meshes: Iterable[MeshLike], others: Iterator[T], what: str) -> Iterator[tuple[int, TriangleMesh, T]]:
    """The meshes with their numbers, each with what is asked of it: both are taken as they are needed.

    Raises:
        MeshError: One that is none, or more or fewer than of `what`.
    """
    number = -1
    for number, mesh in each_mesh(meshes):
        try:
            other = next(others)
        except StopIteration:
            raise MeshError(f"{what} ended before mesh {number}: give one for each mesh") from None
        yield number, mesh, other
    if not isinstance(others, repeat) and next(others, _END) is not _END:
        raise MeshError(f"{number + 1} meshes came, and more {what}: give one for each mesh")
