"""Surfaces of maps: seconds against resolution, ours and other libraries', each with its errors beside it.

    python -m sdm.bench.surface --device cpu --out surface-cpu.json

For each mesh and resolution the exact map is made once; then each method makes its surface `--runs` times by turns.
`seconds` are medians of repeated calls, `cpu` those of all cores together: on a machine that others use too, only these
compare. Ours stay on the device, the others' begin with values on the host. Before that: `open` is how many edges are
not there once each way, `zero` how many triangles have no area, `vertices` the largest distance of a vertex from the
mesh, and `edges` the mean distance of points of the mesh's edges of more than 30 degrees from the surface,
`edges_most` the largest, in voxels.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.timing import once
from sdm.bench.surface.figures import draw
from sdm.bench.surface.methods import Surface, methods_of
from sdm.core.mesh import TriangleMesh

MESHES = ("fandisk", "rocker-arm", "nefertiti")
RESOLUTIONS = (128, 256)


def measure(case: Case, device: str, resolution: int, runs: int, *, alone: bool = False) -> list[dict[str, Any]]:
    """A row for each method."""
    mesh = sdm.TriangleMesh(case.vertices, case.faces, case.name).to(device)
    grid, index = sdm.Grid.around(mesh, resolution), sdm.MeshIndex(mesh, device)
    calls = methods_of(index.signed_distance_map(grid), index, index.narrow_band(grid), alone=alone)
    edges = sharp_points(mesh)
    rows, times = [], {name: [] for name in calls}
    for name, call in calls.items():
        row = {"method": name, "mesh": case.name, "resolution": resolution}
        rows.append(row | errors(call(), mesh, edges, grid.spacing[0]))
    for _ in range(runs):
        for name, call in calls.items():
            begin = time.process_time()
            ms, _ = once(call, device)
            times[name].append((ms / 1e3, time.process_time() - begin))
    for row in rows:
        wall, cpu = zip(*times[row["method"]], strict=True)
        row |= {"seconds": statistics.median(wall), "cpu": statistics.median(cpu), "all_seconds": list(wall)}
    return rows


def errors(
    surface: TriangleMesh | Surface, mesh: sdm.TriangleMesh, edges: torch.Tensor | None, voxel: float
) -> dict[str, Any]:
    """Closedness of a surface, and its distances from the mesh in voxels."""
    found = TriangleMesh(*surface).to(mesh.device) if isinstance(surface, tuple) else surface
    corners, count = found.faces.long(), len(found.vertices)
    start, end = corners.reshape(-1), corners.roll(-1, 1).reshape(-1)
    forth, uses = torch.unique(start * count + end, return_counts=True)
    back = torch.unique(end * count + start)
    # Edges of both are there once in each.
    both = 2 * (len(forth) + len(back) - len(torch.unique(torch.cat([forth, back]))))
    a, b, c = found.vertices.double()[corners].unbind(1)
    away = None if edges is None else sdm.signed_distance(found, edges, sign="none") / voxel
    return {
        "triangles": len(corners),
        "open": len(forth) + len(back) - both + int((uses > 1).sum()),
        "zero": int((torch.linalg.cross(b - a, c - a).norm(dim=1) == 0).sum()),
        "vertices": float(sdm.signed_distance(mesh, found.vertices, sign="none").max()) / voxel,
        "edges": None if away is None else float(away.mean()),
        "edges_most": None if away is None else float(away.max()),
    }


def sharp_points(mesh: sdm.TriangleMesh, degrees: float = 30.0) -> torch.Tensor | None:
    """Ten points on each edge whose faces differ by more; None if there is none."""
    import trimesh

    found = trimesh.Trimesh(*mesh.numpy(), process=True)
    sharp = found.face_adjacency_edges[found.face_adjacency_angles > np.radians(degrees)]
    if not len(sharp):
        return None
    ends, share = found.vertices[sharp], np.linspace(0, 1, 10)[:, None, None]
    points = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
    return torch.from_numpy(points.reshape(-1, 3)).float().to(mesh.device)


def line(row: dict[str, Any]) -> str:
    """A line of the table that is printed."""
    edges = "" if row["edges"] is None else f"{row['edges']:.4f}{row['edges_most']:>8.3f}"
    return (
        f"{row['mesh']:12}{row['resolution']:>5}^3  {row['method']:22}{row['seconds']:>9.4f}{row['cpu']:>9.4f}"
        f"{row['triangles']:>12,}{row['open']:>6}{row['zero']:>6}{row['vertices']:>10.4f}{edges:>18}"
    )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--meshes", nargs="*", default=list(MESHES), help="names, torus-N, or files")
    parser.add_argument("--resolutions", type=int, nargs="*", default=list(RESOLUTIONS))
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--alone", action="store_true", help="without other libraries")
    parser.add_argument("--add", action="store_true", help="keep the other rows of the file that is there")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    print(
        f"{'':42}{'seconds':>9}{'cpu':>9}{'triangles':>12}{'open':>6}{'zero':>6}{'vertices':>10}{'edges':>10}{'most':>8}",
        flush=True,
    )
    rows: list[dict[str, Any]] = json.loads(given.out.read_text())["rows"] if given.add else []
    for name in given.meshes:
        if (why := missing_note(name)) is not None:
            print(why)
            continue
        for resolution in given.resolutions:
            case = load_case(name)
            found = measure(case, given.device, resolution, given.runs, alone=given.alone)
            rows = [row for row in rows if (row["mesh"], row["resolution"]) != (case.name, resolution)] + found
            print(*map(line, found), sep="\n", flush=True)
            if given.out:
                json_file.write(given.out, {"machine": describe(given.device), "rows": rows})
    if given.out and rows:
        draw(json.loads(given.out.read_text()), given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
