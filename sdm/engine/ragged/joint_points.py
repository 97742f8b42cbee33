"""Scattered points of meshes that differ: one build and one query for all, in packets of one mesh each.

Closed meshes are asked about as one mesh is. Of open ones, whose winding numbers are found in ways of their own, the
query finds distances alone, and other kernels the signs (`sdm.kernels.points.open_signs`). What a point's distance is
does not depend on the packet that it is in, nor does its sign where it is off the surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from sdm.engine.ops import SMALLEST_SORT, is_sorted
from sdm.engine.plan_override import OPTIONS
from sdm.engine.points import unsigned_winding
from sdm.engine.ragged.open_points import OpenData
from sdm.engine.ragged.structure import RaggedStructure
from sdm.engine.structure.sizes import MeshKind
from sdm.kernels.bvh.tree import COUNT
from sdm.kernels.points.open_signs import sign_points
from sdm.kernels.points.packets import PACKET
from sdm.kernels.points.plan import plan_points
from sdm.kernels.points.query import query_points, sort_points
from sdm.runtime.torch_warp import as_warp, on_current_stream, to_device, workspace


def ragged_points(
    structure: RaggedStructure, places: Sequence[int], points: Sequence[Tensor], hits: bool, signed: bool = True
) -> list[tuple[Tensor, ...]]:
    """Signed distances (N,) of points (N,3) from meshes, and with `hits` closest points, faces and coordinates.

    Args:
        structure: Of some meshes.
        places: Those that are asked about, by their places there, from low to high: closed ones, or open ones, if they
            are to be signed.
        points: (N,3) float32 for each of these, on their device: as many as there are, or none.
        hits: Whether closest points are wanted.
        signed: Whether sides are: else distances are what they are outside.
    """
    at = torch.cat(list(points))
    counts, device = [part.shape[0] for part in points], at.device
    # As many in each packet as in a call about one mesh.
    shares = [plan_points(count, at.is_cuda, OPTIONS.get()).share for count in counts]
    total = sum(counts)
    found = [torch.empty(total, dtype=torch.float32, device=device)]
    if hits:
        found += [torch.empty_like(at), torch.empty(total, dtype=torch.int32, device=device), torch.empty_like(at)]
    if total:
        _fill(structure, places, at, counts, shares, found, signed)
    return list(zip(*(whole.split(counts) for whole in found), strict=True))


def _fill(
    structure: RaggedStructure,
    places: Sequence[int],
    at: Tensor,
    counts: list[int],
    shares: list[int],
    found: list[Tensor],
    signed: bool,
) -> None:
    """Measure all points (N,3), so many of each mesh and so many in a packet, into `found`: see `ragged_points`."""
    total, device, values = len(at), at.device, found[0]
    # Of open meshes alone.
    boundaries = structure.boundaries if signed and places[0] in structure.kinds else None
    packets = [-(-count // share) for count, share in zip(counts, shares, strict=True)]
    most = sum(packets)
    # Of each mesh its points and packets, whether they are taken along a curve though others are, how many points
    # are in a packet, and its first point and place.
    sort = total >= SMALLEST_SORT
    along = [sort and _is_along(structure, i, count) for i, count in zip(places, counts, strict=True)]
    sort = any(along)
    rows = torch.tensor([list(places), counts, packets, along, shares], dtype=torch.int64, device="cpu")
    before = rows.cumsum(1) - rows
    table = to_device(torch.cat([rows, before[1:2], PACKET * before[2:3]]), device)
    owners = table[0].repeat_interleave(table[1], output_size=total).int()
    of_packets = table[0].repeat_interleave(table[2], output_size=most).int()
    order = torch.empty(2 * total, dtype=torch.int32, device=device)
    keys = torch.empty(2 * total if sort else 0, dtype=torch.int64, device=device)
    in_places = torch.full((PACKET * most,), -1, dtype=torch.int32, device=device)
    numbers = torch.arange(total, dtype=torch.int64, device=device)
    share, first, place = table[4:].repeat_interleave(table[1], 1, output_size=total)
    moved = place + PACKET * ((numbers - first) // share) + (numbers - first) % share
    with on_current_stream(at, at, structure.memory, structure.parts, owners, of_packets, order, keys, in_places):
        tree, winding, _, features, cones = structure.view
        where, empty = as_warp(at, wp.vec3), workspace(device)
        if sort:
            sort_points(where, as_warp(owners, wp.int32), tree, as_warp(keys, wp.int64), as_warp(order, wp.int32))
            ordered = order[:total]
            if not all(along):
                ordered = torch.where(table[3].repeat_interleave(table[1], output_size=total) > 0, ordered, numbers)
            in_places[moved] = ordered.int()
        else:
            in_places[moved] = numbers.int()
        room = None
        if len(found) > 1:
            room = as_warp(found[1], wp.vec3), as_warp(found[2], wp.int32), as_warp(found[3], wp.vec3)
        plan = plan_points(PACKET * most, at.is_cuda, OPTIONS.get(), in_packets=True)
        by, found_values = as_warp(in_places, wp.int32), as_warp(values, wp.float32)
        asked = query_points(
            tree,
            features,
            cones,
            winding if signed and boundaries is None else unsigned_winding(),
            where,
            by,
            found_values,
            room,
            empty,
            plan,
            as_warp(of_packets, wp.int32),
        )
        if boundaries is not None:
            data = OpenData(structure, boundaries, places)
            sign_points(tree, data.view, where, by, asked, found_values, empty, plan, data.sixteens)


def _is_along(structure: RaggedStructure, mesh: int, count: int) -> bool:
    """True if a mesh's points are gone through along a curve where those of all are.

    Of a mesh with many boundary edges that is as in a call by itself: on its surface sides are found by the crossings
    of a ray or by solid angles, as the packet is far from holes or not.
    """
    if structure.kinds.get(mesh) is not MeshKind.MANY:
        return True
    return is_sorted(count, structure.rows[mesh][COUNT], structure.memory.is_cuda)
