"""Meshes to PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdm.core.mesh import TriangleMesh
from sdm.io.files.atomic import replacing

FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_ply(mesh: TriangleMesh, path: str | Path) -> None:
    """Write a mesh as binary PLY, atomically.

    Raises:
        FormatError: A place that cannot be written.
    """
    vertices, faces = mesh.numpy()
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{axes}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), FACE)
    rows["count"], rows["corners"] = 3, faces
    with replacing(Path(path)) as part, part.open("wb") as file:
        file.write(header.encode())
        file.write(vertices.astype("<f4", copy=False).tobytes())
        file.write(rows.tobytes())
