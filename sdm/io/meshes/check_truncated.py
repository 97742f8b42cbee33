"""Mesh files that parsers take although something is wrong with them: cut off, or with a vertex that is not there."""

from __future__ import annotations

import re
from pathlib import Path

from sdm.errors import MeshError
from sdm.io.meshes.gltf import check_gltf

STL_HEADER, STL_FACE = 84, 50
# A face that uses vertex 0: OBJ counts from 1, and trimesh takes 0 for 1.
OBJ_VERTEX_0 = re.compile(rb"^[ \t]*f[ \t](?:[^\n#]*[ \t])?0+(?=[/\s]|$)", re.MULTILINE)
OFF_HEADER = re.compile(rb"\s*\w*OFF\s+(\d+)\s+(\d+)")
PLY_HEADER = re.compile(rb"ply\s.*?end_header[^\n]*\n", re.DOTALL)
PLY_ELEMENT = re.compile(rb"^element\s+\w+\s+(\d+)", re.MULTILINE)
COMMENT = re.compile(rb"#[^\n]*")


def check_whole(path: Path) -> None:
    """Look at a file for what its parser passes over.

    Raises:
        MeshError: An STL, PLY or OFF file that holds less than it says, a binary STL file that holds more, an OBJ file
            with a face that uses vertex 0, or a glTF file of a kind that would be read wrongly.
    """
    check = CHECKS.get(path.suffix.lower())
    if check is not None:
        check(path, path.read_bytes())


def _stl(path: Path, data: bytes) -> None:
    said = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    if len(data) == STL_HEADER + STL_FACE * said:
        return
    if data.lstrip()[:5].lower() == b"solid":
        if b"endsolid" not in data[-1000:].lower():
            raise MeshError(f"{path} is cut off: it does not end with endsolid")
    elif len(data) >= STL_HEADER:
        _enough(path, (len(data) - STL_HEADER) // STL_FACE, said, "triangles")
        # Its parser would look for text, and find nothing.
        raise MeshError(f"{path} is damaged: its header promises {said} triangles, and more than these are there")


def _ply(path: Path, data: bytes) -> None:
    header = PLY_HEADER.match(data)
    if header is None or b"format ascii" not in header[0]:
        return
    lines = sum(1 for line in data[header.end() :].splitlines() if line.strip())
    _enough(path, lines, sum(map(int, PLY_ELEMENT.findall(header[0]))), "lines")


def _off(path: Path, data: bytes) -> None:
    text = COMMENT.sub(b"", data)
    header = OFF_HEADER.match(text)
    if header is not None:
        # The rest of the header's line, the number of edges, is not always there.
        lines = sum(1 for line in text[header.end() :].splitlines()[1:] if line.strip())
        vertices, faces = int(header[1]), int(header[2])
        # Fewer lines than vertices: several on a line, which is allowed.
        if lines >= vertices:
            _enough(path, lines, vertices + faces, "lines")


def _obj(path: Path, data: bytes) -> None:
    if OBJ_VERTEX_0.search(data):
        raise MeshError(f"a face of {path} uses vertex 0, but OBJ files number vertices from 1")


def _enough(path: Path, found: int, said: int, what: str) -> None:
    if found < said:
        raise MeshError(f"{path} is cut off or damaged: its header promises {said} {what}, and {found} are there")


CHECKS = {".stl": _stl, ".ply": _ply, ".off": _off, ".obj": _obj, ".glb": check_gltf, ".gltf": check_gltf}
