"""A template with triangles of even size and shape: marching cubes of its exact map, then relaxed on its surface."""

from __future__ import annotations

import torch

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError

RELAXATIONS = 30
FEWEST, MOST = 100, 200_000


def even_template(mesh: TriangleMesh, triangles: int, device: torch.device | str) -> TriangleMesh:
    """About `triangles` even triangles on the surface of a closed mesh.

    Marching cubes give some three triangles for each square of the spacing. Vertices then move to the middle of their
    neighbours and back to the nearest point of the surface, again and again.

    Raises:
        MeshError: Another number of triangles than is supported, or a surface that falls apart at that spacing.
    """
    if not FEWEST <= triangles <= MOST:
        raise MeshError(f"a template of {triangles} triangles was requested; {FEWEST} to {MOST:,} are supported")
    index = MeshIndex(mesh, device=device)
    a, b, c = index.mesh.vertices[index.mesh.faces.long()].unbind(1)
    area = float(torch.linalg.cross(b - a, c - a).norm(dim=1).double().sum()) / 2
    spacing = (3 * area / triangles) ** 0.5
    found = index.signed_distance_map(Grid.around(mesh, spacing=spacing, margin=0.1)).to_mesh(method="cubes")
    x, faces = found.vertices, found.faces.long()
    ring = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = torch.zeros(len(x), device=x.device).index_add(0, ring[:, 0], torch.ones(len(ring), device=x.device))
    for _ in range(RELAXATIONS):
        middle = torch.zeros_like(x).index_add(0, ring[:, 0], x[ring[:, 1]]) / count[:, None]
        x = index.signed_distance((x + middle) / 2, return_closest=True)[1].points
    return TriangleMesh(x, found.faces, mesh.name, check=False)
