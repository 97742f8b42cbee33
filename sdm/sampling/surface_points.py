"""Random points of a surface, evenly by area."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.given_values import whole
from sdm.core.random import derive_seed
from sdm.errors import MeshError, SDMError
from sdm.shapes.sampling import uniform


def surface_points(mesh: MeshLike, count: int, *, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Independent random points of a mesh, uniform by area, and their normals.

    Args:
        mesh: Any triangles, as a mesh of any kind that `as_mesh` takes.
        count: How many.
        seed: Any whole number; the points are a pure function of it.

    Returns:
        Points (count,3) and unit outward normals (count,3), float32 on the mesh's device.

    Raises:
        MeshError: Every triangle has zero area.
        SDMError: Less than no points.
    """
    mesh = as_mesh(mesh)
    if (number := whole(count, 0)) is None:
        raise SDMError(f"{count!r} points were requested; give 0 or more")
    corners = mesh.vertices.detach()[mesh.faces.long()]
    areas = triangle_areas(corners)
    total = areas.cumsum(0)
    if not bool(total[-1] > 0):
        raise MeshError(f"every triangle of {mesh.name} has zero area; points of its surface need some")
    numbers = uniform(derive_seed(seed, "surface points"), torch.arange(number, device=mesh.device), 4)
    # 24 random bits are too few to choose among millions of triangles, so two numbers make one.
    choice = (numbers[:, 0].double() + numbers[:, 1].double() * 2.0**-24) * total[-1]
    face = torch.searchsorted(total, choice, right=True).clamp(max=len(areas) - 1)
    chosen = corners[face]
    normal = torch.linalg.cross(*(chosen[:, 1:] - chosen[:, :1]).double().unbind(1))
    return in_triangle(chosen, numbers[:, 2:]), torch.nn.functional.normalize(normal, dim=1, eps=0.0).float()


def in_triangle(corners: Tensor, uniform: Tensor) -> Tensor:
    """Points (...,3), evenly in triangles (...,3,3), from uniform numbers (...,2)."""
    root = uniform[..., :1].sqrt()
    a, b, c = corners.unbind(-2)
    return (1 - root) * a + root * (1 - uniform[..., 1:]) * b + root * uniform[..., 1:] * c


def triangle_areas(corners: Tensor) -> Tensor:
    """Areas (F,) float64 of triangles (F,3,3)."""
    wide = corners.double()
    return torch.linalg.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]).norm(dim=1) / 2
