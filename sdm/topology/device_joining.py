"""Boundary edges of a mesh and the caps of its loops, found on a GPU: its host waits for numbers alone."""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.boundary_flags import FLAGS, NUMBERS, WRONG_EDGES
from sdm.kernels.topology.boundary_loops import join_edges
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace
from sdm.topology.cap_triangles import remember_joined
from sdm.topology.face_pairing import Pairing

# Unmatched edges that are joined on the device, at most.
MOST_JOINED = 1 << 18
# Devices that join a mesh's unmatched edges themselves: a CPU's host does it in less time.
JOINING_DEVICES = ("cuda",)


def boundary_on_device(pairing: Pairing, vertices: Tensor, found: Tensor | None = None) -> Tensor | None:
    """The boundary edges (E,2) int32 of one open mesh, found on the device and remembered together with their caps.

    Waits for the device once, or twice where there are not as many as before, or as unmatched ones if nobody knows.

    Args:
        pairing: Of its faces.
        vertices: (V,3) float32, contiguous.
        found: (2,) int32, what `queue_pairing` found, if it is still there.

    Returns:
        None if that does not serve: on a CPU, or for too many edges.
    """
    unmatched = pairing.unmatched
    rows = unmatched.shape[0]
    if not 0 < rows <= MOST_JOINED or vertices.device.type not in JOINING_DEVICES:
        return None
    if found is None:
        found = torch.tensor([0, rows], dtype=torch.int32, device=vertices.device)
        if unmatched.untyped_storage().nbytes() > unmatched.nbytes:
            # A part of a larger tensor would keep it all.
            pairing.unmatched = unmatched = unmatched.clone()
    count = rows if pairing.edges is None else pairing.edges.shape[0]
    flags, edges, caps = queue_joining(unmatched, found, vertices[None], rows, count)
    said = flags.tolist()
    if said[WRONG_EDGES]:
        count += said[WRONG_EDGES]
        if count == 0:
            # They close it, so that the rest does not matter.
            edges, caps, said = edges[:0], caps[:0], [0]
        else:
            flags, edges, caps = queue_joining(unmatched, found, vertices[None], rows, count)
            said = flags.tolist()
    if any(said):
        return None
    remember_joined(pairing, edges, caps)
    return edges


def queue_joining(
    unmatched: Tensor, found: Tensor, vertices: Tensor, rows: int, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Queue the boundary edges and caps of `queue_pairing`'s result for `vertices` (B,V,3).

    That `rows` edges are unmatched and `count` bound the mesh is a guess.

    Returns:
        Flags, zeros if the guess was right; else nothing is right. The boundary edges (count,2), and the caps
        (count,3).
    """
    device = vertices.device
    numbers, flat = torch.zeros(NUMBERS + 2 * count, dtype=torch.int32, device=device).split([NUMBERS, 2 * count])
    caps = torch.empty(count, 3, dtype=torch.int32, device=device)
    bounds = flat.view(count, 2)
    with on_current_stream(vertices, vertices):
        join_edges(
            as_warp(unmatched[:rows], wp.int32),
            as_warp(found, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(bounds, wp.int32),
            as_warp(caps, wp.int32),
            as_warp(numbers, wp.int32),
            workspace(device),
        )
    return numbers[:FLAGS], bounds, caps
