"""Distances between a mesh and the closed surface made of it, both ways."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch

from sdm.core.mesh import TriangleMesh
from sdm.engine.api import signed_distance
from sdm.errors import MeshError
from sdm.sampling.surface_points import surface_points

SAMPLES = 100_000


@dataclass(frozen=True)
class Deviation:
    """Distances of one surface's points from another surface, in the mesh's unit.

    Args:
        largest: Over all vertices and samples.
        mean: Over samples that are even by area.
        points: How many there are. Each distance is exact; between the points nothing is known.
    """

    largest: float
    mean: float
    points: int


@dataclass(frozen=True)
class WatertightReport:
    """A closed surface beside the mesh that it was made of. Lengths are in the mesh's unit.

    Args:
        name: The mesh's name.
        triangles: Of the mesh.
        closed: Whether the mesh was closed: no edge has one face alone, and no face is there twice.
        sign: The method that said what is inside.
        spacing: Edge of a voxel.
        shape: Voxels (nx,ny,nz).
        offset: The distance of the surface from the mesh.
        hole_size: Of a flood, the width of the narrowest gaps that it passes; None without one.
        hidden: "drop" or "keep".
        output_triangles: Of the surface.
        input_to_output: From the mesh to the surface. What was hidden inside and dropped is far away.
        output_to_input: From the surface to the mesh.
    """

    name: str
    triangles: int
    closed: bool
    sign: str
    spacing: float
    shape: tuple[int, int, int]
    offset: float
    hole_size: float | None
    hidden: str
    output_triangles: int
    input_to_output: Deviation
    output_to_input: Deviation

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, ready for JSON."""
        return asdict(self)


def deviation(source: TriangleMesh, target: TriangleMesh, samples: int = SAMPLES) -> Deviation:
    """Distances of a mesh's vertices, and of points on its faces, from another mesh."""
    used = torch.zeros(len(source.vertices), dtype=torch.bool, device=source.device)
    used[source.faces.reshape(-1)] = True
    vertices = source.vertices[used]
    # Where the meshes are, not on whichever GPU is there.
    device = source.device if source.device.type == "cuda" else target.device
    at_vertices = signed_distance(target, vertices, device=device, sign="none")
    try:
        points = surface_points(source, samples)[0]
    except MeshError:
        # No face has an area.
        return Deviation(float(at_vertices.max()), float(at_vertices.mean()), len(vertices))
    within = signed_distance(target, points, device=device, sign="none")
    largest = max(float(at_vertices.max()), float(within.max()))
    return Deviation(largest, float(within.double().mean()), len(vertices) + samples)
