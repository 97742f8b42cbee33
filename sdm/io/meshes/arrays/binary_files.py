"""Binary PLY and STL files, read in worker processes, and what there is to know of their meshes."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sdm.io.files.checksum import mesh_digest
from sdm.io.meshes.arrays.triangles import checked_and_merged
from sdm.io.meshes.ply import read_ply
from sdm.io.meshes.ply_header import parse_header
from sdm.io.meshes.polygons import check_indices, triangulate
from sdm.io.meshes.stl import read_stl
from sdm.topology.paired_edges import every_edge_is_paired

READERS = {".ply": read_ply, ".stl": read_stl}
# Bytes of a file whose mesh takes longer to send than others to read meanwhile.
LARGEST = 1 << 26


class BinaryMesh(NamedTuple):
    """A mesh that was read.

    Args:
        vertices: (V,3) float32.
        faces: (F,3) int32.
        largest: The largest absolute coordinate.
        box: Lowest and highest coordinates, (3,) float64, of vertices that faces use.
        digest: Of the mesh and what it was asked with.
        paired: Whether each edge belongs to two faces, once in each direction. Such a mesh is closed; others may be.
    """

    vertices: np.ndarray
    faces: np.ndarray
    largest: float
    box: tuple[np.ndarray, np.ndarray]
    digest: str
    paired: bool


def read_binary(path: Path, how: str) -> BinaryMesh | None:
    """The mesh of a file, as `load_mesh` has it; None of a file for `load_mesh` to read, or to say what is wrong.

    Args:
        path: The file.
        how: Of the digest: see `sdm.io.maps.record.digest_of`.
    """
    try:
        str(path).encode()
        ending = path.suffix.lower()
        if path.stat().st_size > LARGEST:
            return None
        data = path.read_bytes()
        if parse_header(data).ascii if ending == ".ply" else data.lstrip()[:5].lower() == b"solid":
            # Text is a kernel's to read.
            return None
        mesh = READERS[ending](data, path)
        check_indices(mesh.corners, len(mesh.vertices), path)
        vertices, faces, largest = checked_and_merged(mesh.vertices, triangulate(mesh), path)
    # Parsers of damaged files raise whatever they come across.
    except Exception:  # noqa: BLE001
        return None
    # Views of a file's rows would be sent with their gaps.
    vertices, faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces)
    box, digest = _box(vertices, faces), mesh_digest(vertices, faces, how)
    return BinaryMesh(vertices, faces, largest, box, digest, every_edge_is_paired(faces))


def _box(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The `bounds` of the mesh."""
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    placed = vertices if used.all() else vertices[used]
    return placed.min(0).astype(np.float64), placed.max(0).astype(np.float64)
