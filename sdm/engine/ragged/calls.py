"""Maps of lists of meshes: chunks of those that can be measured together, the others one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import torch
from torch import Tensor

from sdm.core.as_grid import as_grid
from sdm.core.as_mesh import MeshLike
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.arguments import Orient, SignMethod, oriented
from sdm.engine.closest_points import Closest
from sdm.engine.flood import flooded, rims_of
from sdm.engine.map_check import MapCheck, checked, named
from sdm.engine.map_closest import closest_map
from sdm.engine.plan_override import OPTIONS
from sdm.engine.ragged.boxes import with_known_boxes
from sdm.engine.ragged.chunks import Load, bytes_for, in_chunks, voxels_of
from sdm.engine.ragged.joint_maps import JointMaps, MapJob, ragged_maps
from sdm.engine.ragged.lists import each_grid, in_pairs, is_crowded, is_plain, numbered
from sdm.kernels.dense.cost_model import search_is_faster

# A map of more voxels fills a device by itself.
LARGEST_JOINED = 1 << 27


# A map, and its closest points where they are wanted.
Found: TypeAlias = "SDM | tuple[SDM, Closest]"


@dataclass(frozen=True)
class Wanted:
    """Options of a call that are the same for all meshes of a list."""

    method: SignMethod
    orient: Orient
    closest: bool


def maps_of(
    meshes: Iterable[MeshLike],
    grids: Any,
    single: Callable[[TriangleMesh, Grid, torch.device], Found],
    wanted: Wanted,
    *,
    resolution: int | None,
    margin: float | None,
    device: str | torch.device | None,
    max_bytes: int | None,
) -> Iterator[Found]:
    """The maps of meshes, in order, each as it is asked for; see `sdm.signed_distance_maps`.

    Args:
        meshes: A list or an iterator.
        grids: One for all, or one for each.
        single: The map of one mesh by itself, which is turned already, on a device.
        wanted: What is asked of each.
        resolution: Voxels along each axis of a cube around each mesh, in place of grids.
        margin: Room in that cube.
        device: Where to compute.
        max_bytes: Memory of a chunk.
    """

    def jobs() -> Iterator[MapJob]:
        def is_around(grid: Any) -> bool:
            return not isinstance(grid, Grid) or resolution is not None or margin is not None

        pairs: Iterable[tuple[int, TriangleMesh, Any]] = in_pairs(meshes, each_grid(meshes, grids), "grids")
        boxes: Sequence[TriangleMesh] = ()
        # Files are read as they are needed.
        if isinstance(meshes, list | tuple) and all(isinstance(mesh, TriangleMesh) for mesh in meshes):
            pairs = list(pairs)
            if any(is_around(grid) for _, _, grid in pairs):
                boxes = with_known_boxes([mesh for _, mesh, _ in pairs])
        for number, mesh, asked in pairs:
            given, grid, where = mesh, asked, choose_device(device, mesh.vertices)
            if is_around(asked):
                box = boxes[number] if boxes else mesh
                grid = numbered(number, partial(as_grid, asked, box, resolution, margin))
            if wanted.orient != "keep":
                given = numbered(number, partial(oriented, mesh, wanted.orient, where))
            yield MapJob(number, given.to(where), grid, given)

    def load(job: MapJob) -> Load:
        return Load(len(job.mesh), voxels_of(job.grid.shape))

    for chunk in in_chunks(jobs(), load, lambda job: max_bytes or bytes_for(job.mesh.device)):
        yield from _maps_of_chunk(chunk, single, wanted)


def _maps_of_chunk(
    chunk: Sequence[MapJob], single: Callable[[TriangleMesh, Grid, torch.device], Found], wanted: Wanted
) -> list[Found]:
    found: dict[int, Found] = {}
    alike: dict[tuple[torch.device, bool], list[MapJob]] = {}
    for job in chunk:
        if _can_join(job):
            alike.setdefault((job.mesh.device, job.turned), []).append(job)
    for (where, _), jobs in alike.items():
        if len(jobs) > 1:
            nbytes = sum(job.grid.nbytes for job in jobs)
            with torch.no_grad(), memory_guard(nbytes, where, f"{len(jobs)} maps"):
                joint = ragged_maps(jobs, signed=wanted.method.needs_winding)
                for place, (job, made) in enumerate(zip(jobs, joint.maps, strict=True)):
                    if made is not None:
                        found[job.number] = numbered(job.number, partial(_result, job, joint, place, *made, wanted))
    for job in chunk:
        if job.number not in found:
            with named(f"mesh {job.number}: "):
                make = partial(single, job.given or job.mesh, job.grid, job.mesh.device)
                found[job.number] = numbered(job.number, make)
    return [found[job.number] for job in chunk]


def _result(job: MapJob, joint: JointMaps, place: int, values: Tensor, ambiguous: int, wanted: Wanted) -> Found:
    """The result of a mesh whose map was made with others': with the sign and the closest points that are wanted."""
    grid, structure = job.grid, joint.structure

    def flood(distances: Tensor, hole: float) -> Tensor:
        edges = structure.boundary_of(place)
        return flooded(
            distances,
            hole,
            grid=grid,
            structure=structure.of_mesh(place),
            mesh=job.mesh,
            rims=rims_of(job.mesh, edges),
            closed=edges.shape[0] == 0,
        )

    method = wanted.method
    if method.is_default:
        field = SDM(values, grid, ambiguous, sign="winding")
    else:
        winding = SDM(values, grid, ambiguous, sign="winding") if method.needs_winding else None
        field = method.field(grid, values if winding is None else values.abs(), winding, flood)
    with named(f"mesh {job.number}: "):
        checked(MapCheck(), field, job.given or job.mesh)
    if not wanted.closest:
        return field
    around = structure.neighbours_of(place)
    hit = closest_map(job.mesh, structure.of_mesh(place), grid, known=values, around=around)
    return field, Closest(hit.points, hit.faces, hit.barycentric, job.mesh, grid)


def _can_join(job: MapJob) -> bool:
    return (
        is_plain(job.mesh)
        and math.prod(job.grid.shape) <= LARGEST_JOINED
        and not _is_searched(job)
        and not is_crowded(job.mesh)
    )


def _is_searched(job: MapJob) -> bool:
    """True for the plain path. Without a plan, as the device waits until there are jobs."""
    gpu, method = job.mesh.device.type == "cuda", OPTIONS.get().method
    return method == "search" or (method == "auto" and search_is_faster(len(job.mesh), job.grid.shape, gpu))
