"""Build of a mesh never seen before, whose boundary is found while its tree is made.

What a mesh's faces say has to be known on the host before the kernels for its boundary can be launched. A wait for that
would leave the device idle while the host prepares all that follows; so the kernels that do not depend on it are queued
first, and by the time that they are the answer is there.
"""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.engine.acceleration import (
    AccelerationStructure,
    Sizes,
    closed_by_faces,
    fill_boundary,
    fill_surface,
    kind_of,
    layout,
    topology_for,
)
from sdm.engine.structure.sizes import MOST_BOUNDARY_EDGES
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology import guesses
from sdm.topology.boundary_edges import MeshTopology
from sdm.topology.cap_triangles import turned_faces
from sdm.topology.face_pairing import PairingUnderWay, remember

# Boundary edges that a new mesh's block has room for: with more, it is copied into a larger one.
ROOM = MOST_BOUNDARY_EDGES


def build_first(vertices: Tensor, faces: Tensor) -> tuple[AccelerationStructure, MeshTopology]:
    """The structure, for maps alone, of one mesh whose faces were never seen, and their topology.

    Both are contiguous, (V,3) and (F,3).

    Raises:
        MeshError: A face index out of range.
    """
    count, device, batch = vertices.shape[0], vertices.device, vertices[None]
    # The kernels trust the faces, which only later turn out to be out of range.
    within = torch.empty_like(faces)
    under_way = PairingUnderWay(faces, count, within)
    # The arrays of a closed mesh come first, at the same places; behind them is room for a boundary.
    without, most = (Sizes(1, faces.shape[0], edges, kind_of(edges, faces.shape[0])) for edges in (0, ROOM))
    block = torch.empty(layout(most)[0], dtype=torch.uint8, device=device)
    closed = AccelerationStructure.in_block(without, device, block[: layout(without)[0]])
    room = torch.empty(6, dtype=torch.float32, device=device)
    with on_current_stream(vertices, vertices, within):
        bounds = as_warp(room, wp.float32)
        fill_surface(closed.view, batch, within, under_way.neighbours, bounds)
        pairing = under_way.finish()
        remember(faces, count, pairing)
        topology = guesses.topology_on_device(under_way, pairing, vertices, faces)
        if topology is None:
            topology = topology_for(vertices, faces)
            guesses.remember(faces, count, topology.boundary)
        edges = topology.boundary.shape[0]
        if edges == 0:
            return closed, topology
        sizes = Sizes(1, faces.shape[0], edges, kind_of(edges, faces.shape[0]))
        if closed_by_faces(sizes.kind, edges, faces.shape[0]):
            topology = topology._replace(caps=turned_faces(faces))
        length = layout(sizes)[0]
        if length <= block.shape[0]:
            structure = AccelerationStructure.in_block(sizes, device, block[:length])
        else:
            structure = AccelerationStructure.in_block(sizes, device)
            structure.memory[0][: layout(without)[0]].copy_(closed.memory[0])
        fill_boundary(structure, batch, topology, bounds, for_maps=True)()
    return structure, topology
