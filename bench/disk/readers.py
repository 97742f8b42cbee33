"""Megabytes a second that mesh files are read at, by one core's CPU time, here and by other libraries."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sdm.bench.disk.inputs import write_meshes
from sdm.io import load_mesh

ENDINGS = ("ply", "stl", "obj", "off")


def peers() -> dict[str, Callable[[str], Any]]:
    """Other readers that are installed, by name. None of them checks what `load_mesh` checks."""
    found: dict[str, Callable[[str], Any]] = {}
    if find_spec("trimesh"):
        import trimesh

        found["trimesh"] = lambda path: trimesh.load_mesh(path, process=False)
    if find_spec("meshio"):
        import meshio

        found["meshio"] = meshio.read
    if find_spec("pyminiply"):
        import pyminiply

        found["pyminiply"] = pyminiply.read
    if find_spec("igl"):
        import igl

        found["libigl"] = igl.read_triangle_mesh
    if find_spec("open3d"):
        import open3d

        found["Open3D"] = open3d.io.read_triangle_mesh
    return found


def readers(folder: Path, triangles: int, runs: int) -> list[dict[str, Any]]:
    """Rows: ending, reader, megabytes a second and milliseconds a file, the best of the runs."""
    rows = []
    for ending in ENDINGS:
        (file,) = write_meshes(folder / f"{ending}-{triangles}", 1, triangles, ending)
        size = file.stat().st_size
        for name, read in {"sdm": load_mesh, **peers()}.items():
            if name == "pyminiply" and ending != "ply":
                continue
            try:
                best = min(_cpu_seconds(read, file) for _ in range(runs))
            except Exception as error:  # noqa: BLE001
                rows.append({"ending": ending, "reader": name, "why not": str(error)[:80]})
                continue
            row = {"ending": ending, "reader": name, "triangles": triangles, "megabytes": round(size / 1e6, 3)}
            rows.append({**row, "mb_per_s": round(size / 1e6 / best, 1), "ms": round(1e3 * best, 2)})
    return rows


def _cpu_seconds(read: Callable[[str], Any], file: Path) -> float:
    start = time.process_time()
    read(str(file))
    return time.process_time() - start
