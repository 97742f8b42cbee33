"""Boxes of a list of meshes, which a GPU is waited for once for."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
from jaxtyping import Float32
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.runtime.torch_warp import to_device


def with_known_boxes(meshes: Sequence[TriangleMesh]) -> list[TriangleMesh]:
    """For each mesh one of the same box and name, whose bounds are there at once: itself on the host.

    Of meshes on a GPU a triangle on the host that spans the box.
    """
    found = list(meshes)
    there: dict[torch.device, list[int]] = {}
    for i, mesh in enumerate(meshes):
        if mesh.device.type == "cuda":
            there.setdefault(mesh.device, []).append(i)
    one = torch.tensor([[0, 1, 2]], dtype=torch.int32, device="cpu")
    for numbers in there.values():
        for i, box in zip(numbers, boxes_of([meshes[i] for i in numbers]).cpu(), strict=True):
            found[i] = TriangleMesh(box, one, meshes[i].name, check=False)
    return found


def boxes_of(meshes: Sequence[TriangleMesh]) -> Float32[Tensor, "meshes 3 3"]:
    """The lowest, the highest and again the lowest coordinates of the vertices that faces use, for each mesh.

    As many operations however many meshes there are.
    """
    device = meshes[0].device
    with torch.no_grad():
        vertices = torch.cat([mesh.vertices for mesh in meshes])
    counts = [mesh.vertices.shape[0] for mesh in meshes]
    corners = [3 * mesh.faces.shape[0] for mesh in meshes]
    rows = torch.tensor([corners, [0, *accumulate(counts[:-1])], counts], dtype=torch.int64, device="cpu")
    lengths, first, most = to_device(rows, device)
    named = torch.cat([mesh.faces.view(-1) for mesh in meshes]).long()
    both = torch.stack([first, most - 1], 1)
    first, last = torch.repeat_interleave(both, lengths, dim=0, output_size=sum(corners)).unbind(1)
    # One out of range is refused later, by the mesh's number.
    used = vertices[named.clamp(min=0).minimum(last).add_(first)]
    # Safe would be to wait for the device and look at the lengths.
    low = torch.segment_reduce(used, "min", lengths=lengths, unsafe=True)
    high = torch.segment_reduce(used, "max", lengths=lengths, unsafe=True)
    return torch.stack([low, high, low], 1)
