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
