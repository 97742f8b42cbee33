"""Maps of lists of meshes: chunks of those that can be measured together, the others one by one."""

from __future__ import annotations

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
from sdm.engine.capacity.ready_maps import looks_closed
from sdm.engine.checks.caller_warning import named
from sdm.engine.checks.map_check import MapCheck, checked, later_check
from sdm.engine.closest_points import Closest
from sdm.engine.flood import flooded, rims_of
from sdm.engine.map_closest import closest_map
from sdm.engine.plan_override import OPTIONS
from sdm.engine.ragged.boxes import with_known_boxes
from sdm.engine.ragged.chunks import bytes_for, check_bytes, in_chunks
from sdm.engine.ragged.joint_maps import JointMaps, MapJob, ragged_maps
from sdm.engine.ragged.mesh_lists import each_grid, in_pairs, is_crowded, numbered
from sdm.kernels.dense.cost_model import search_is_faster
from sdm.runtime.operators import are_eager
from sdm.runtime.torch_warp import has_forward_mode, refuse_other_modes

# A map of more voxels fills a device by itself.
LARGEST_JOINED = 1 << 27
# Devices whose recordings make maps of open meshes one by one: together, each waits for its boundary and has launches
# of its own, which take the host four times as long.
RECORDING_DEVICES = ("cuda",)


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
    if max_bytes is not None:
        check_bytes(max_bytes)
    jobs = _jobs(meshes, grids, wanted, resolution, margin, device)
    for chunk in in_chunks(jobs, _load, lambda job: max_bytes or bytes_for(job.mesh.device)):
        yield from _maps_of_chunk(chunk, single, wanted)


def _load(job: MapJob) -> tuple[int, int]:
    return job.triangles, job.voxels


def _jobs(
    meshes: Iterable[MeshLike],
    grids: Any,
    wanted: Wanted,
    resolution: int | None,
    margin: float | None,
    device: str | torch.device | None,
) -> Iterator[MapJob]:
    around = resolution is not None or margin is not None
    pairs: Iterable[tuple[int, TriangleMesh, Any]] = in_pairs(meshes, each_grid(meshes, grids), "grids")
    boxes: Sequence[TriangleMesh] = ()
    # Files are read as they are needed.
    if isinstance(meshes, list | tuple) and {TriangleMesh}.issuperset(map(type, meshes)):
        pairs = list(pairs)
        if around or not {Grid}.issuperset([type(grid) for _, _, grid in pairs]):
            boxes = with_known_boxes([mesh for _, mesh, _ in pairs])
    places: dict[torch.device, torch.device] = {}
    for number, mesh, asked in pairs:
        given, grid, there = mesh, asked, mesh.vertices.device
        where = places.get(there)
        if where is None:
            where = places[there] = choose_device(device, mesh.vertices)
        if around or not isinstance(asked, Grid):
            box = boxes[number] if boxes else mesh
            grid = numbered(number, partial(as_grid, asked, box, resolution, margin))
        if wanted.orient != "keep":
            given = numbered(number, partial(oriented, mesh, wanted.orient, where))
        yield MapJob(number, given if there == where else given.to(where), grid, given)


def _maps_of_chunk(
    chunk: Sequence[MapJob], single: Callable[[TriangleMesh, Grid, torch.device], Found], wanted: Wanted
) -> list[Found]:
    found: dict[int, Found] = {}
    for jobs in _joinable(chunk, wanted):
        nbytes = sum([job.grid.nbytes for job in jobs])
        with torch.no_grad(), memory_guard(nbytes, jobs[0].mesh.device, f"{len(jobs)} maps"):
            joint = ragged_maps(jobs, signed=wanted.method.needs_winding)
            simple = wanted.method.is_default and not wanted.closest and is_read_later(jobs[0].mesh.device)
            for place, job in enumerate(jobs):
                if simple and place not in joint.left:
                    check = later_check(job.given, f"mesh {job.number}: ", "winding")
                    make = partial(joint.values, place)
                    found[job.number] = SDM.later(make, job.grid, joint.counts[place], sign="winding", check=check)
                elif place not in joint.left:
                    found[job.number] = numbered(job.number, partial(_result, job, joint, place, wanted))
    for job in chunk:
        if job.number not in found:
            with named(f"mesh {job.number}: "):
                make = partial(single, job.given, job.grid, job.mesh.device)
                found[job.number] = numbered(job.number, make)
    return [found[job.number] for job in chunk]


def is_read_later(device: torch.device) -> bool:
    """True if maps on a device are read on the host later than they are made: nobody looks at them before."""
    return device.type == "cuda"


def _result(job: MapJob, joint: JointMaps, place: int, wanted: Wanted) -> Found:
    """The result of a mesh whose map was made with others': with the sign and the closest points that are wanted."""
    grid, structure, values = job.grid, joint.structure, joint.values(place)

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
    winding = SDM(values, grid, joint.counts[place], sign="winding") if method.needs_winding else None
    if method.is_default and winding is not None:
        field = winding
    else:
        field = method.field(grid, values if winding is None else values.abs(), winding, flood)
    if field.sign == "winding" and not values.is_cuda:
        # The check asks for it.
        structure.remember_pairing(place)
    with named(f"mesh {job.number}: "):
        checked(MapCheck(), field, job.given)
    if not wanted.closest:
        return field
    around = structure.neighbours_of(place)
    hit = closest_map(job.mesh, structure.of_mesh(place), grid, known=values, around=around)
    return field, Closest(hit.points, hit.faces, hit.barycentric, job.mesh, grid)


def _joinable(chunk: Sequence[MapJob], wanted: Wanted) -> list[list[MapJob]]:
    """Those that can be measured together, two or more at a time: on one device, turned or not."""
    if has_forward_mode():
        for job in chunk:
            refuse_other_modes(job.mesh.vertices)
    method = OPTIONS.get().method
    if method == "search":
        return []
    plain = wanted.method.is_default and not wanted.closest
    alike: dict[tuple[torch.device, bool], list[MapJob]] = {}
    for job, eager in zip(chunk, are_eager([job.mesh.vertices for job in chunk]), strict=True):
        shape, device = job.grid.shape, job.mesh.vertices.device
        gpu = device.type == "cuda"
        if not eager or shape[0] * shape[1] * shape[2] > LARGEST_JOINED or (not gpu and is_crowded(job.mesh)):
            continue
        # Without a plan, as the device waits until there are jobs.
        if method == "auto" and search_is_faster(job.triangles, shape, gpu):
            continue
        if plain and device.type in RECORDING_DEVICES and not looks_closed(job.triangles, job.mesh.vertices.shape[0]):
            continue
        alike.setdefault((device, job.turned), []).append(job)
    return [jobs for jobs in alike.values() if len(jobs) > 1]
