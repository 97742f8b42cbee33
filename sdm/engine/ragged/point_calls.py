"""Scattered points of lists of meshes: chunks of those that can be asked together, the others one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from sdm.core.as_mesh import MeshLike
from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.engine.arguments import Sign
from sdm.engine.checks.caller_warning import named
from sdm.engine.checks.values_check import look_at_points
from sdm.engine.closest_points import Closest
from sdm.engine.points import as_points, search_needs_tree_alone
from sdm.engine.ragged.chunks import bytes_for, check_bytes, in_chunks
from sdm.engine.ragged.joint_points import ragged_points
from sdm.engine.ragged.mesh_lists import each_points, in_pairs, is_crowded, is_plain, numbered
from sdm.engine.ragged.structure import RaggedBuild
from sdm.engine.repeated_faces import may_be_crowded
from sdm.runtime.operators import is_eager

# Voxels whose memory a point takes: for keys and orders, and its closest point.
POINT_VOXELS = 12


class PointsJob(NamedTuple):
    """A mesh, on its device, and points (...,3) there."""

    number: int  # of the mesh in the whole list
    mesh: TriangleMesh
    points: Tensor


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
    if max_bytes is not None:
        check_bytes(max_bytes)

    def asked() -> Iterator[PointsJob]:
        for number, mesh, at in in_pairs(meshes, each_points(meshes, points), "points"):
            where = choose_device(device, at if isinstance(at, Tensor) else None, mesh.vertices)
            placed = mesh.to(where)
            yield PointsJob(number, placed, numbered(number, partial(as_points, at, where)))

    def load(job: PointsJob) -> tuple[int, int]:
        # A point takes as much as so many voxels, while it is sorted and looked up.
        return job.mesh.faces.shape[0], POINT_VOXELS * (job.points.numel() // 3)

    for chunk in in_chunks(asked(), load, lambda job: max_bytes or bytes_for(job.mesh.device)):
        found = _together(chunk, closest, sign)
        for job in chunk:
            yield _looked_at(job, found.pop(job.number), sign) if job.number in found else _by_itself(job, single)


def _looked_at(job: PointsJob, values: Any, sign: Sign) -> Any:
    """The answer, of which it was said if it is probably not what was meant; a GPU would be waited for."""
    if not job.points.is_cuda:
        with named(f"mesh {job.number}: "):
            look_at_points(job.mesh, job.points, values, sign)
    return values


def _by_itself(job: PointsJob, single: Callable[..., Any]) -> Any:
    with named(f"mesh {job.number}: "):
        return numbered(job.number, partial(single, job.mesh, job.points, job.mesh.device))


def _together(chunk: Sequence[PointsJob], closest: bool, sign: Sign) -> dict[int, Any]:
    """The results of meshes that can be built together, by their numbers."""
    alike: dict[torch.device, list[PointsJob]] = {}
    for job in chunk:
        if is_plain(job.mesh) and is_eager(job.points) and not is_crowded(job.mesh):
            alike.setdefault(job.mesh.device, []).append(job)
    found: dict[int, Any] = {}
    for jobs in alike.values():
        if len(jobs) < 2:
            continue
        alone = search_needs_tree_alone(jobs[0].mesh.device)
        build = RaggedBuild([job.mesh for job in jobs], tree_alone=alone)
        structure = build.finish([job.number for job in jobs])
        kept = [i for i, job in enumerate(jobs) if not may_be_crowded(job.mesh, structure.edges_of(i))]
        signed = sign != "none"
        # Sides of open meshes are found in other ways.
        is_open = [signed and i in structure.kinds for i in kept]
        for of_open in (False, True):
            some = [i for i, is_one in zip(kept, is_open, strict=True) if is_one == of_open]
            if some:
                rows = [jobs[i].points.reshape(-1, 3) for i in some]
                answers = ragged_points(structure, some, rows, closest, signed)
                for i, (values, *hit) in zip(some, answers, strict=True):
                    found[jobs[i].number] = _shaped(jobs[i], values, hit)
    return found


def _shaped(job: PointsJob, values: Tensor, hit: Sequence[Tensor]) -> Any:
    shape = job.points.shape[:-1]
    if not hit:
        return values.reshape(shape)
    point, face, barycentric = hit
    places = point.reshape(*shape, 3), face.reshape(shape), barycentric.reshape(*shape, 3)
    return values.reshape(shape), Closest(*places, job.mesh, job.points)
