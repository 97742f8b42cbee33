"""Small work for every kernel of distances, for tools that watch a GPU: `python -m sdm.bench.gpu.gpu_work DEVICE N`.

Meshes closed, open and without an inside; both paths of maps; points; batches; the distance transform.
"""

from __future__ import annotations

import sys

import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.engine.plan_override import plan_override

MESHES = ("torus-2000", "open hemisphere", "random soup", "zero-area faces", "coincident shells")


def small(resolution: int, device: str) -> int:
    """Maps, points, a batch and a distance transform; returns how many results were finite numbers throughout."""
    # Under so small a grid no triangle would count as large.
    with plan_override(most_columns=1 if device.startswith("cuda") else None):
        return _small(resolution, device)


def _small(resolution: int, device: str) -> int:
    fine = 0
    for name in MESHES:
        case = load_case(name)
        mesh = sdm.TriangleMesh(case.vertices, case.faces, name)
        index = sdm.MeshIndex(mesh, device)
        # Not a multiple of the cells' edge, so that cells at the border are cut.
        grid = sdm.Grid.around(mesh, resolution=resolution + 3)
        for method in ("cells", "search"):
            with plan_override(method=method):
                fine += bool(index.signed_distance_map(grid).values.isfinite().all())
        points = grid.points().reshape(-1, 3)[:: max(1, grid.size // 5000)].to(device)
        distance, hit = index.signed_distance(points, return_closest=True)
        fine += bool(distance.isfinite().all() and (hit.faces >= 0).all())
        fine += bool(index.signed_distance(points).isfinite().all() and index.winding_number(points).isfinite().all())
    case = load_case("torus-500")
    vertices = torch.from_numpy(case.vertices).to(device)[None] * torch.tensor([1.0, 0.8], device=device)[:, None, None]
    grid = sdm.Grid.around(sdm.TriangleMesh(case.vertices, case.faces), resolution=resolution)
    with plan_override(method="cells"):
        maps = sdm.signed_distance_maps(vertices, torch.from_numpy(case.faces).to(device), grid)
    fine += bool(maps.isfinite().all())
    fine += bool(sdm.euclidean_distance_transform(maps[0] < 0, spacing=(1.0, 0.7, 1.3)).isfinite().all())
    return fine


def main() -> int:
    """Arguments: device, resolution; 0 if every result is fine."""
    device, resolution = sys.argv[1:]
    expected = 4 * len(MESHES) + 2
    fine = small(int(resolution), device)
    print(f"{fine} of {expected} results are finite")
    return int(fine != expected)


if __name__ == "__main__":
    sys.exit(main())
