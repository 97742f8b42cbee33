"""The acceleration structure as torch tensors, so that torch's allocator and streams look after its memory.

Warp frees its own arrays on the stream that is current when Python lets go of them, which may be another than the
one whose kernels still read them. Everything here is a torch tensor instead: freed memory is reused only after the
work queued before it on its stream, and `record_stream` tells the allocator of every other stream that reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.errors import MeshError
from sdm.kernels import cones, frames, parts, points, solid_angle, tree
from sdm.kernels.boundary import Boundary, gather_boundary
from sdm.kernels.launch import launch
from sdm.mesh import MOST_TRIANGLES
from sdm.topology import boundary_edges, loops, neighbours

# Above this many boundary edges the tree of dipoles costs less than visiting every edge.
MOST_BOUNDARY_EDGES = 1024

_TORCH_TYPE = {wp.float32: torch.float32, wp.int32: torch.int32, wp.float64: torch.float64}
_FIELDS = ("corners", "lattice", "face", "boxes", "frame")
_ELEMENT = {
    "corners": wp.vec3,
    "lattice": wp.vec2i,
    "face": wp.int32,
    "boxes": wp.float32,
    "frame": wp.float64,
}


@contextmanager
def on_current_stream(tensor: Tensor, *reads: Tensor) -> Iterator[wp.Device]:
    """Launch Warp kernels on torch's current stream of `tensor`'s device; `reads` stay alive until they are done."""
    device = wp.device_from_torch(tensor.device)
    if not device.is_cuda:
        yield device
        return
    with torch.cuda.device(tensor.device):
        stream = torch.cuda.current_stream()
        for read in reads:
            if read.numel():
                read.record_stream(stream)
        with wp.ScopedStream(wp.stream_from_torch(stream), sync_enter=False):
            yield device


def kind_of(edges: Tensor) -> int:
    """How the sign of a mesh with these boundary edges is found."""
    count = edges.shape[0]
    return points.CLOSED if count == 0 else points.OPEN if count <= MOST_BOUNDARY_EDGES else points.SOUP


def as_warp(tensor: Tensor, dtype: Any) -> wp.array:
    """A torch tensor as a Warp array over the same memory."""
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def scratch_on(device: torch.device) -> Callable[[int, Any], wp.array]:
    """An allocator of scratch arrays for kernels: torch's memory, kept by the Warp array for as long as it lives."""

    def empty(length: int, dtype: Any) -> wp.array:
        shape = (length, 3) if dtype is wp.vec3 else (length,)
        return as_warp(torch.empty(shape, dtype=_TORCH_TYPE.get(dtype, torch.float32), device=device), dtype)

    return empty


def build(vertices: Tensor, faces: Tensor, edges: Tensor | None = None) -> tuple[list[Tensor], int]:
    """Build the hierarchy of a batch of meshes on their device.

    Args:
        vertices: (B,V,3) float32, contiguous.
        faces: (F,3) int32, contiguous, shared.
        edges: (E,2) int32 boundary edges, found here if None.

    Returns:
        The tensors that `unpack` understands, and the kind of mesh.

    Raises:
        MeshError: More triangles in all than the kernels can count.
    """
    if vertices.shape[0] * faces.shape[0] > MOST_TRIANGLES:
        raise MeshError(
            f"{vertices.shape[0]:,} meshes of {faces.shape[0]:,} triangles are more than the {MOST_TRIANGLES:,} that "
            "one call can take; use smaller batches, or a coarser mesh"
        )
    if edges is None:
        edges = boundary_edges(vertices, faces)
    kind = kind_of(edges)
    meshes, count = vertices.shape[0], faces.shape[0]

    def empty(shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=vertices.device)

    tensors = [empty(shape, _TORCH_TYPE[dtype]) for shape, dtype in tree.sizes(meshes, count).values()]
    ends = 2 * meshes * edges.shape[0] if kind == points.OPEN else 0
    nodes = tensors[_FIELDS.index("boxes")].shape[0] // tree.BOX_FLOATS if kind == points.SOUP else 0
    tensors += [empty((meshes * count * frames.FRAME_FLOATS,), torch.float32)]
    tensors += [empty((meshes * count * parts.PARTS_FLOATS,), torch.float32)]
    tensors += [empty((meshes * count * parts.INVERSES,), torch.float64)]
    tensors += [empty((meshes * count * 4,), torch.float32)]
    tensors += [empty((meshes * count * 4,), torch.float32)]
    tensors += [empty((meshes << (tree.depth_for(count) + 3),), torch.float32)]
    tensors += [empty((ends, 3), torch.float32), empty((ends, 2), torch.int32), empty((ends // 2, 3), torch.float32)]
    tensors += [empty((nodes * solid_angle.MOMENTS_SIZE,), torch.float32)]
    scratch = empty((6 * meshes,), torch.float32), empty((2 * meshes * count,), torch.int64)
    slots = empty((2 * meshes * count,), torch.int32)
    shared = neighbours(faces, vertices.shape[1])
    around = loops(edges) if kind == points.OPEN else edges
    with on_current_stream(vertices, vertices, faces, edges, shared, around):
        hierarchy, winding, local, pieces, facing = unpack(tensors, kind, meshes)
        corners = as_warp(vertices, wp.vec3)
        tree.build(
            hierarchy,
            corners,
            as_warp(faces, wp.int32),
            as_warp(scratch[0], wp.float32),
            as_warp(scratch[1], wp.int64),
            as_warp(slots, wp.int32),
            launch,
        )
        frames.make_frames(hierarchy, local, launch)
        for make, out in ((parts.make_parts, pieces), (cones.make_cones, facing)):
            make(hierarchy, corners, as_warp(faces, wp.int32), as_warp(shared, wp.int32), out, launch)
        if kind == points.OPEN:
            gather_boundary(
                winding.boundary, hierarchy, corners, as_warp(edges, wp.int32), as_warp(around, wp.int32), launch
            )
        elif kind == points.SOUP:
            solid_angle.build_moments(hierarchy, winding.moments, meshes, launch)
    return tensors, kind


def unpack(tensors: list[Tensor], kind: int, meshes: int) -> tuple[Any, Any, wp.array, Any, Any]:
    """The kernels' view of what `build` made: a `Tree`, a `Winding`, the triangles' frames, `Parts` and `Cones`."""
    hierarchy = tree.Tree()
    for name, tensor in zip(_FIELDS, tensors, strict=False):
        setattr(hierarchy, name, as_warp(tensor, _ELEMENT[name]))
    local, rows, inverses, balls, of_triangles, of_nodes, ends, ends_lattice, apexes, moments = tensors[len(_FIELDS) :]
    hierarchy.count = tensors[_FIELDS.index("face")].shape[0] // meshes
    hierarchy.depth = tree.depth_for(hierarchy.count)
    boundary = Boundary()
    boundary.ends = as_warp(ends, wp.vec3)
    boundary.lattice = as_warp(ends_lattice, wp.vec2i)
    boundary.apexes = as_warp(apexes, wp.vec3)
    boundary.count = ends.shape[0] // (2 * meshes)
    winding = points.Winding()
    winding.boundary = boundary
    winding.moments = as_warp(moments, wp.float32)
    winding.kind = kind
    pieces = parts.Parts()
    pieces.rows = as_warp(rows, wp.float32)
    pieces.inverses = as_warp(inverses, wp.float64)
    pieces.balls = as_warp(balls, wp.float32)
    facing = cones.Cones()
    facing.triangles = as_warp(of_triangles, wp.float32)
    facing.nodes = as_warp(of_nodes, wp.float32)
    return hierarchy, winding, as_warp(local, wp.float32), pieces, facing


def one_of(tensors: list[Tensor], mesh: int, meshes: int) -> list[Tensor]:
    """The hierarchy of one mesh of a batch: slices, no copies."""
    return [t[mesh * (t.shape[0] // meshes) : (mesh + 1) * (t.shape[0] // meshes)] for t in tensors]
