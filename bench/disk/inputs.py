"""Meshes for the bench: many that differ, in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from sdm.bench.common.meshes import torus


def bent(triangles: int, number: int) -> trimesh.Trimesh:
    """A closed torus of about `triangles` triangles, bent by its number."""
    vertices, faces = (np.asarray(array) for array in torus(triangles))
    phase = 0.37 * number
    moved = vertices * (1 + 0.08 * np.sin(4 * vertices[:, [1, 2, 0]] + phase))
    return trimesh.Trimesh(moved, faces, process=False)


def write_meshes(folder: Path, count: int, triangles: int, ending: str) -> list[Path]:
    """Files of `count` meshes."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{number:05}.{ending}" for number in range(count)]
    for number, file in enumerate(files):
        bent(triangles, number).export(file)
    return files


def write_small(folder: Path, count: int) -> list[Path]:
    """Binary STL files of `count` octahedra that differ, a thousand in a folder."""
    corners = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    top = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]])
    faces = np.concatenate([top, np.where(top == 2, 5, top)[:, ::-1]])
    files = []
    for number in range(count):
        rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        rows["corners"] = (corners * (1 + 0.3 * np.sin(0.1 * number + np.arange(3))))[faces]
        file = folder / f"{number // 1000:05}" / f"{number:08}.stl"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + rows.tobytes())
        files.append(file)
    return files
