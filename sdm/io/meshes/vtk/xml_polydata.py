"""`.vtp`, VTK's XML files of surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from sdm.errors import MeshError
from sdm.io.files.vtk_xml import VtkFile, data_array, offsets_of, write_file
from sdm.io.meshes.polygons import PolygonMesh

KIND = "PolyData"


def read_vtp(data: bytes, path: Path) -> PolygonMesh:
    """Points and polygons of a `.vtp` file; points and lines without area are left out.

    Raises:
        MeshError: It has triangle strips.
        ValueError: It is something else, or damaged.
    """
    file = VtkFile(data, KIND)
    points, lengths, corners = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for piece in file.root.iterfind(f"{KIND}/Piece"):
        if int(piece.get("NumberOfStrips", "0")):
            raise MeshError(
                f"{path} has triangle strips, which are not read: save it with polygons (vtkTriangleFilter)"
            )
        first = sum(map(len, points))
        places = piece.find("Points/DataArray")
        arrays = {array.get("Name"): array for array in piece.iterfind("Polys/DataArray")}
        if places is None or not {"connectivity", "offsets"} <= set(arrays):
            continue
        ends = file.values(arrays["offsets"]).astype(np.int64)
        points.append(file.values(places).reshape(-1, 3).astype(np.float64))
        lengths.append(np.diff(ends, prepend=0))
        corners.append(file.values(arrays["connectivity"]).astype(np.int64) + first)
        if (lengths[-1] < 0).any() or lengths[-1].sum() != len(corners[-1]):
            raise ValueError("its polygons do not use up their corners")
    return PolygonMesh(np.concatenate(points), np.concatenate(lengths), np.concatenate(corners))


def write_vtp(vertices: np.ndarray, faces: np.ndarray, file: BinaryIO) -> None:
    """Write vertices (V,3) and faces (F,3) as a `.vtp` file."""
    arrays = {
        "Points": vertices.astype("<f4"),
        "connectivity": faces.astype("<i4").ravel(),
        "offsets": np.arange(3, 3 * len(faces) + 1, 3, dtype="<i4"),
    }
    places, corners, ends = (
        data_array(name, values, at)
        for (name, values), at in zip(arrays.items(), offsets_of(arrays.values()), strict=True)
    )
    inside = (
        f'<PolyData>\n<Piece NumberOfPoints="{len(vertices)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" '
        f'NumberOfPolys="{len(faces)}">\n<Points>\n{places}</Points>\n<Polys>\n{corners}{ends}</Polys>\n</Piece>\n'
        "</PolyData>\n"
    )
    write_file(file, KIND, inside, arrays.values())
