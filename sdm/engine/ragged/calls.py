"""The public calls about lists of meshes: chunks of those that can be measured together, the others one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import as_grid
from sdm.core.as_mesh import MeshLike
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.acceleration import AccelerationStructure
from sdm.engine.arguments import refuse_forward_mode
from sdm.engine.map_check import quiet
from sdm.engine.plan_override import OPTIONS
from sdm.engine.ragged.boxes import with_known_boxes
from sdm.engine.ragged.chunks import Load, bytes_for, in_chunks, voxels_of
from sdm.engine.ragged.joint_maps import MapJob, ragged_maps
from sdm.engine.ragged.lists import each_grid, each_points, in_pairs, numbered
from sdm.engine.ragged.structure import RaggedBuild
from sdm.engine.repeated_faces import CROWDED
from sdm.kernels.dense.cost_model import search_is_faster
from sdm.runtime.operators import is_eager

# A map of more voxels fills a device by itself.
LARGEST_JOINED = 1 << 27


def maps_of(
    meshes: Iterable[MeshLike],
    grids: Any,
    single: Callable[[TriangleMesh, Grid], SDM],
    *,
    resolution: int | None,
    margin: float | None,
    device: str | torch.device | None,
    max_bytes: int | None,
) -> Iterator[SDM]:
    """The maps of meshes, in order, each as it is asked for; see `sdm.signed_distance_maps`.

    Args:
        meshes: A list or an iterator.
        grids: One for all, or one for each.
        single: The map of one mesh by itself, on its device.
        resolution: Voxels along each axis of a cube around each mesh, in place of grids.
        margin: Room in that cube.
        device: Where to compute.
        max_bytes: Memory of a chunk.
    """

    def jobs() -> Iterator[MapJob]:
        def is_around(wanted: Any) -> bool:
            return not isinstance(wanted, Grid) or resolution is not None or margin is not None

        pairs: Iterable[tuple[int, TriangleMesh, Any]] = in_pairs(meshes, each_grid(meshes, grids), "grids")
        boxes: Sequence[TriangleMesh] = ()
        # Files are read as they are needed.
        if isinstance(meshes, list | tuple) and all(isinstance(mesh, TriangleMesh) for mesh in meshes):
            pairs = list(pairs)
            if any(is_around(wanted) for _, _, wanted in pairs):
                boxes = with_known_boxes([mesh for _, mesh, _ in pairs])
        for number, mesh, wanted in pairs:
            grid = wanted
            if is_around(wanted):
                box = boxes[number] if boxes else mesh
                grid = numbered(number, lambda box=box, wanted=wanted: as_grid(wanted, box, resolution, margin))
            yield MapJob(number, mesh.to(choose_device(device, mesh.vertices)), grid)

    def load(job: MapJob) -> Load:
        return Load(len(job.mesh), voxels_of(job.grid.shape))

    for chunk in in_chunks(jobs(), load, lambda job: max_bytes or bytes_for(job.mesh.device)):
        yield from _maps_of_chunk(chunk, single)


def distances_of(
    meshes: Iterable[MeshLike],
    points: Any,
    single: Callable[[TriangleMesh, Tensor, AccelerationStructure | None], Tensor],
    *,
    device: str | torch.device | None,
    max_bytes: int | None,
) -> Iterator[Tensor]:
    """Signed distances of points from each mesh, in order, each as it is asked for; see `sdm.signed_distances`.

    Args:
        meshes: A list or an iterator.
        points: Of each mesh.
        single: The distances from one mesh, by its structure if that is there.
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
        alike: dict[torch.device, list[tuple[int, TriangleMesh]]] = {}
        for number, mesh, _ in chunk:
            if _is_plain(mesh):
                alike.setdefault(mesh.device, []).append((number, mesh))
        built = {}
        for some in alike.values():
            if len(some) > 1:
                numbers, together = zip(*some, strict=True)
                structure = RaggedBuild(together).finish(numbers)
                built.update((number, partial(structure.of_mesh, place)) for place, number in enumerate(numbers))
        for number, mesh, at in chunk:
            own = built.get(number)
            yield numbered(number, lambda mesh=mesh, at=at, own=own: single(mesh, at, own() if own else None))


def _maps_of_chunk(chunk: Sequence[MapJob], single: Callable[[TriangleMesh, Grid], SDM]) -> list[SDM]:
    found: dict[int, SDM] = {}
    alike: dict[tuple[torch.device, bool], list[MapJob]] = {}
    for job in chunk:
        if _can_join(job):
            alike.setdefault((job.mesh.device, job.turned), []).append(job)
    for (where, _), jobs in alike.items():
        if len(jobs) > 1:
            nbytes = sum(job.grid.nbytes for job in jobs)
            with torch.no_grad(), memory_guard(nbytes, where, f"{len(jobs)} maps"):
                for job, made in zip(jobs, ragged_maps(jobs), strict=True):
                    if made is not None:
                        found[job.number] = SDM(made[0], job.grid, made[1], sign="winding")
    for job in chunk:
        if job.number not in found:
            with quiet():
                found[job.number] = numbered(job.number, lambda job=job: single(job.mesh, job.grid))
    return [found[job.number] for job in chunk]


def _can_join(job: MapJob) -> bool:
    return (
        _is_plain(job.mesh)
        and math.prod(job.grid.shape) <= LARGEST_JOINED
        and not _is_searched(job)
        # A mesh of copies of few triangles.
        and (job.mesh.device.type == "cuda" or len(job.mesh) < CROWDED * job.mesh.vertices.shape[0])
    )


def _is_searched(job: MapJob) -> bool:
    """True for the plain path. Without a plan, as the device waits until there are jobs."""
    gpu, method = job.mesh.device.type == "cuda", OPTIONS.get().method
    return method == "search" or (method == "auto" and search_is_faster(len(job.mesh), job.grid.shape, gpu))


def _is_plain(mesh: TriangleMesh) -> bool:
    refuse_forward_mode(mesh.vertices)
    return is_eager(mesh.vertices)
