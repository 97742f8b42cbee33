"""Scattered points of lists of meshes: chunks of those that can be built together, the others one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_mesh import MeshLike
from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure
from sdm.engine.arguments import Sign
from sdm.engine.points import at_points
from sdm.engine.ragged.chunks import Load, bytes_for, in_chunks
from sdm.engine.ragged.lists import each_points, in_pairs, is_crowded, is_plain, numbered
from sdm.engine.ragged.structure import RaggedBuild
from sdm.engine.repeated_faces import may_be_crowded


def distances_of(
    meshes: Iterable[MeshLike],
    points: Any,
    single: Callable[..., Any],
    closest: bool,
    sign: Sign,
    *,
    device: str | torch.device | None,
    max_bytes: int | None,
) -> Iterator[Any]:
    """Signed distances of points from each mesh, in order, each as it is asked for; see `sdm.signed_distances`.

    Args:
        meshes: A list or an iterator.
        points: Of each mesh.
        single: The distances of points from one mesh by itself, on a `device`.
        closest: Whether closest points are wanted.
        sign: By which method.
        device: Where to compute.
        max_bytes: Memory of a chunk.
    """

    def asked() -> Iterator[tuple[int, TriangleMesh, Any]]:
        for number, mesh, at in in_pairs(meshes, each_points(meshes, points), "points"):
            where = choose_device(device, at if isinstance(at, Tensor) else None, mesh.vertices)
            yield number, mesh.to(where), at

    def load(item: tuple[int, TriangleMesh, Any]) -> Load:
        return Load(len(item[1]))

    for chunk in in_chunks(asked(), load, lambda item: max_bytes or bytes_for(item[1].device)):
        built = _built(chunk)
        for number, mesh, at in chunk:
            own = built.get(number)
            if own is None:
                yield numbered(number, partial(single, mesh, at, mesh.device))
            else:
                yield numbered(number, lambda mesh=mesh, at=at, own=own: at_points(mesh, at, closest, own(), sign=sign))


def _built(chunk: Sequence[tuple[int, TriangleMesh, Any]]) -> dict[int, Callable[[], AccelerationStructure]]:
    """The structures of the meshes that can be built together, by their numbers."""
    alike: dict[torch.device, list[tuple[int, TriangleMesh]]] = {}
    for number, mesh, _ in chunk:
        if is_plain(mesh) and not is_crowded(mesh):
            alike.setdefault(mesh.device, []).append((number, mesh))
    built = {}
    for some in alike.values():
        if len(some) > 1:
            numbers, together = zip(*some, strict=True)
            structure = RaggedBuild(together).finish(numbers)
            for place, number in enumerate(numbers):
                if not may_be_crowded(together[place], structure.boundary_of(place)):
                    built[number] = partial(structure.of_mesh, place)
    return built
