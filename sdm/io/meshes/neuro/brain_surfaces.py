"""Surfaces of brain imaging: GIfTI by nibabel, and FreeSurfer's triangle files.

Coordinates are taken number for number. FreeSurfer's are relative to the centre of its volume (surface RAS): add the
volume's centre, c_ras, to lay them on a scan.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO

import numpy as np

from sdm.errors import MeshError
from sdm.io.meshes.polygons import PolygonMesh

# To which a parser of XML would count.
DIMENSIONS = re.compile(rb"Dimensionality\s*=\s*[\"']\s*\+?([\d_]+)")
# Of a file with triangles; others, of FreeSurfer's early days, have quads.
MAGIC = b"\xff\xff\xfe"


def read_gifti(data: bytes, path: Path) -> PolygonMesh:
    """The pointset and triangles of a GIfTI file.

    Raises:
        MeshError: It has none of one of them, as files of values or labels.
    """
    from nibabel.gifti.gifti import GiftiImage

    if too_many := [number for number in DIMENSIONS.findall(data) if len(number) > 1]:
        raise ValueError(f"an array of it would have {too_many[0][:20].decode()} dimensions")
    image = GiftiImage.from_bytes(data)
    points = image.get_arrays_from_intent("NIFTI_INTENT_POINTSET")
    triangles = image.get_arrays_from_intent("NIFTI_INTENT_TRIANGLE")
    if len(points) != 1 or len(triangles) != 1:
        raise MeshError(
            f"{path} has {len(points)} pointsets and {len(triangles)} sets of triangles, not one each: give a surface"
        )
    faces = np.asarray(triangles[0].data, dtype=np.int64)
    return PolygonMesh.of_triangles(np.asarray(points[0].data, dtype=np.float64), faces)


def read_freesurfer(data: bytes, path: Path) -> PolygonMesh:
    """Vertices and triangles of a FreeSurfer surface, such as lh.pial.

    Raises:
        MeshError: It has quads, or holds less than it says.
        ValueError: It is something else.
    """
    if not data.startswith(MAGIC):
        if data.startswith(b"\xff\xff"):
            raise MeshError(f"{path} is a FreeSurfer surface of quads: convert it with mris_convert")
        raise ValueError("it does not begin as a FreeSurfer surface")
    # Two lines that say who made it when.
    begin = data.index(b"\n", data.index(b"\n", len(MAGIC)) + 1) + 1
    counts = np.frombuffer(data[begin : begin + 8], ">i4")
    if len(counts) < 2 or counts.min() < 0:
        raise ValueError("its counts are damaged")
    vertices, faces = map(int, counts)
    size = 12 * (vertices + faces)
    body = data[begin + 8 : begin + 8 + size]
    if len(body) < size:
        raise MeshError(f"{path} holds less than it says: {vertices:,} vertices and {faces:,} triangles; it is cut off")
    places = np.frombuffer(body[: 12 * vertices], ">f4").reshape(-1, 3)
    corners = np.frombuffer(body[12 * vertices :], ">i4").reshape(-1, 3)
    return PolygonMesh.of_triangles(places.astype(np.float64), corners.astype(np.int64))


def write_gifti(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    """Write vertices (V,3) and faces (F,3) as GIfTI."""
    from nibabel.gifti.gifti import GiftiDataArray, GiftiImage

    arrays = [
        GiftiDataArray(vertices.astype(np.float32), "NIFTI_INTENT_POINTSET", "NIFTI_TYPE_FLOAT32"),
        GiftiDataArray(faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32"),
    ]
    file.write(GiftiImage(darrays=arrays).to_bytes())


def write_freesurfer(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    """Write vertices (V,3) and faces (F,3) as a FreeSurfer surface."""
    file.write(MAGIC + b"created by sdm\n\n")
    file.write(np.array([len(vertices), len(faces)], ">i4").tobytes())
    file.write(vertices.astype(">f4").tobytes())
    file.write(faces.astype(">i4").tobytes())
