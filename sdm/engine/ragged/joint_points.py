"""Scattered points of meshes that differ: one build and one query for all, in packets of one mesh each.

All meshes are taken for closed, which is right of those that are, and of any if the sign does not matter. What a
point's distance is does not depend on the packet that it is in.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from sdm.engine.ops import SMALLEST_SORT
from sdm.engine.plan_override import OPTIONS
from sdm.engine.points import unsigned_winding
from sdm.engine.ragged.structure import RaggedStructure
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
        places: Those that are asked about, by their places there, from low to high.
        points: (N,3) float32 for each of these, on their device: as many as there are, or none.
        hits: Whether closest points are wanted.
        signed: Whether sides are: else distances are what they are outside.
    """
    at = torch.cat(list(points))
    counts, device = [part.shape[0] for part in points], at.device
    packets = [-(-count // PACKET) for count in counts]
    total, most = sum(counts), sum(packets)
    values = torch.empty(total, dtype=torch.float32, device=device)
    found = [values]
    if hits:
        found += [torch.empty_like(at), torch.empty(total, dtype=torch.int32, device=device), torch.empty_like(at)]
    if total:
        # Of each mesh its points and packets, and how far apart its first place and its first point are.
        rows = torch.tensor([list(places), counts, packets], dtype=torch.int64, device="cpu")
        before = rows.cumsum(1) - rows
        table = to_device(torch.cat([rows, (PACKET * before[2] - before[1])[None]]), device)
        owners = table[0].repeat_interleave(table[1], output_size=total).int()
        of_packets = table[0].repeat_interleave(table[2], output_size=most).int()
        order = torch.empty(2 * total, dtype=torch.int32, device=device)
        sort = total >= SMALLEST_SORT
        keys = torch.empty(2 * total if sort else 0, dtype=torch.int64, device=device)
        in_places = torch.full((PACKET * most,), -1, dtype=torch.int32, device=device)
        numbers = torch.arange(total, dtype=torch.int64, device=device)
        moved = numbers + table[3].repeat_interleave(table[1], output_size=total)
        with on_current_stream(at, at, structure.memory, structure.parts, owners, of_packets, order, keys, in_places):
            tree, winding, _, features, cones = structure.view
            where, empty = as_warp(at, wp.vec3), workspace(device)
            if sort:
                sort_points(where, as_warp(owners, wp.int32), tree, as_warp(keys, wp.int64), as_warp(order, wp.int32))
                in_places[moved] = order[:total]
            else:
                in_places[moved] = numbers.int()
            room = None
            if hits:
                room = as_warp(found[1], wp.vec3), as_warp(found[2], wp.int32), as_warp(found[3], wp.vec3)
            query_points(
                tree,
                features,
                cones,
                winding if signed else unsigned_winding(),
                where,
                as_warp(in_places, wp.int32),
                as_warp(values, wp.float32),
                room,
                empty,
                plan_points(PACKET * most, at.is_cuda, OPTIONS.get()),
                as_warp(of_packets, wp.int32),
            )
    return list(zip(*(whole.split(counts) for whole in found), strict=True))
