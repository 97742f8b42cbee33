"""Boxes of a list of meshes, which a GPU is waited for once for."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from sdm.core.mesh import TriangleMesh


def with_known_boxes(meshes: Sequence[TriangleMesh]) -> list[TriangleMesh]:
    """For each mesh one of the same box and name, whose bounds are there at once: itself on the host.

    Of meshes on a GPU a triangle on the host that spans the box.
    """
    found = list(meshes)
    there = [i for i, mesh in enumerate(meshes) if mesh.device.type == "cuda"]
    if not there:
        return found
    corners = []
    for i in there:
        vertices = meshes[i].vertices.detach()
        # One out of range is refused later, by the mesh's number.
        used = vertices.index_select(0, meshes[i].faces.reshape(-1).clamp(0, vertices.shape[0] - 1))
        low, high = torch.aminmax(used, dim=0)
        corners += [low, high, low]
    # To one device, if they are on several.
    first = meshes[there[0]].device
    boxes = torch.stack([corner.to(first) for corner in corners]).view(-1, 3, 3).cpu()
    one = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    for i, box in zip(there, boxes, strict=True):
        found[i] = TriangleMesh(box, one, meshes[i].name, check=False)
    return found
