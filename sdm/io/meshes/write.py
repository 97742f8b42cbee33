"""Meshes to files: `.ply`, `.stl`, `.obj`, `.off`, `.glb`, `.vtk`, `.vtp`, `.gii`, `.pial`, `.white`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, TypeAlias

import numpy as np

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.given_values import as_path
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.meshes.neuro.brain_surfaces import write_freesurfer, write_gifti
from sdm.io.meshes.vtk.legacy_polydata import write_vtk
from sdm.io.meshes.vtk.xml_polydata import write_vtp

# From vertices (V,3), faces (F,3) and an open file.
Writer: TypeAlias = Callable[[np.ndarray, np.ndarray, BinaryIO], None]
PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
STL_HEADER = 80
AT_ONCE = 1 << 14
# Digits that tell every float32 from its neighbours.
DIGITS = "%.9g"


def save_mesh(mesh: MeshLike, path: str | Path) -> None:
    """Write a mesh to `.ply`, `.stl` (both binary), `.obj`, `.off`, `.glb`, `.vtk`, `.vtp`, `.gii` (GIfTI),
    `.pial` or `.white` (FreeSurfer), as the name ends; atomic.

    `load_mesh` gives the same triangles in the same order, bit for bit. `.stl` keeps no shared vertices.

    `mesh` may be whatever `as_mesh` takes for one.

    Raises:
        MeshError: It is no mesh.
        FormatError: Another ending, or a place that cannot be written.
    """
    target = as_path(path)
    _write(as_mesh(mesh), target, WRITERS[ending_to_write(target)])


def write_ply(mesh: TriangleMesh, path: str | Path) -> None:
    """Write a mesh as binary PLY, whatever the name, atomically.

    Raises:
        FormatError: A place that cannot be written.
    """
    _write(mesh, as_path(path), _ply)


def ending_to_write(path: Path) -> str:
    """The ending of a mesh file that can be written.

    Raises:
        FormatError: It is another one.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in WRITERS:
        raise FormatError(f"{path} does not end like a mesh that can be written: use one of .{', .'.join(WRITERS)}")
    return ending


def _write(mesh: TriangleMesh, target: Path, write: Writer) -> None:
    with replacing(target) as part, part.open("wb") as file:
        write(*mesh.numpy(), file)


def _ply(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{axes}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    file.write(header.encode())
    file.write(np.ascontiguousarray(vertices, "<f4").data)
    rows = np.empty(min(len(faces), AT_ONCE), PLY_FACE)
    rows["count"] = 3
    for some in _parts(faces):
        rows[: len(some)]["corners"] = some
        file.write(rows[: len(some)].data)


def _stl(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    file.write(b"sdm".ljust(STL_HEADER) + len(faces).to_bytes(4, "little"))
    rows = np.zeros(min(len(faces), AT_ONCE), STL_FACE)
    for some in _parts(faces):
        corners = vertices[some]
        # Axis by axis: NumPy takes several times as long along a short axis.
        a, b, c = np.ascontiguousarray(corners.transpose(1, 2, 0), np.float64)
        (ux, uy, uz), (vx, vy, vz) = b - a, c - a
        normal = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
        length = np.sqrt((normal * normal).sum(0))
        mine = rows[: len(some)]
        mine["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0).T
        mine["corners"] = corners
        file.write(mine.data)


def _parts(faces: np.ndarray) -> Iterator[np.ndarray]:
    """Rows that are written at once: what is made of them stays in the caches."""
    for begin in range(0, len(faces), AT_ONCE):
        yield faces[begin : begin + AT_ONCE]


def _obj(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    np.savetxt(file, vertices, f"v {DIGITS} {DIGITS} {DIGITS}")
    np.savetxt(file, faces + 1, "f %d %d %d")


def _off(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    file.write(f"OFF\n{len(vertices)} {len(faces)} 0\n".encode())
    np.savetxt(file, vertices, f"{DIGITS} {DIGITS} {DIGITS}")
    np.savetxt(file, faces, "3 %d %d %d")


def _glb(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    import trimesh
    from trimesh.exchange.gltf import export_glb

    file.write(export_glb(trimesh.Scene(trimesh.Trimesh(vertices, faces, process=False))))


WRITERS: dict[str, Writer] = {
    "ply": _ply,
    "stl": _stl,
    "obj": _obj,
    "off": _off,
    "glb": _glb,
    "vtk": write_vtk,
    "vtp": write_vtp,
    "gii": write_gifti,
    "pial": write_freesurfer,
    "white": write_freesurfer,
}
