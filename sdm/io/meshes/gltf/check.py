"""glTF files of which trimesh would make something else without a word, or more than there is memory for."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sdm.errors import MeshError
from sdm.io.meshes.gltf.parts import what_is_missing

GLB, GLB_HEADER, CHUNK_HEADER = b"glTF", 12, 8
DRACO = "KHR_draco_mesh_compression"
INSTANCES = "EXT_mesh_gpu_instancing"
FLOAT, FAN = 5126, 6
# Numbers that accessors without a buffer of their own may hold for each byte of the file and of those beside it:
# Draco needs about a byte for a triangle.
NUMBERS_PER_BYTE = 16


def check_gltf(path: Path) -> None:
    """Look for triangles that trimesh would lose or put elsewhere, and for numbers that no buffer holds.

    Raises:
        MeshError: There are some, or the file is no JSON.
    """
    data = path.read_bytes()
    try:
        document = json.loads(_text(data))
    except ValueError as error:
        if data[:4] == GLB or path.suffix.lower() == ".glb":
            return
        # trimesh would look for another file instead.
        raise MeshError(
            f"{path} cannot be read; it is damaged, or not what its name says (it holds no JSON)"
        ) from error
    broken = next(what_is_missing(document, is_binary=data[:4] == GLB), None)
    if broken is not None:
        raise MeshError(f"{path} cannot be read: {broken}")
    try:
        reason = next(_reasons(document, len(data) + _bytes_beside(document, path)), None)
    # What is damaged is for the parser to refuse.
    except (ValueError, TypeError, KeyError, IndexError, AttributeError):
        return
    if reason is not None:
        raise MeshError(f"{path} has {reason}, which are not read: export it without")


def _text(data: bytes) -> bytes:
    if data[:4] != GLB:
        return data
    begin = GLB_HEADER + CHUNK_HEADER
    return data[begin : begin + int.from_bytes(data[GLB_HEADER : GLB_HEADER + 4], "little")]


def _bytes_beside(document: Any, path: Path) -> int:
    """Bytes of the files that the buffers of a document name."""
    names = [buffer.get("uri", "") for buffer in document.get("buffers", [])]
    files = [path.parent / name for name in names if name and not name.startswith("data:")]
    return sum(file.stat().st_size for file in files if file.is_file())


def _reasons(document: Any, size: int) -> Iterator[str]:
    accessors = document.get("accessors", [])
    # trimesh makes zeros of them before anything says whether they are used.
    if sum(accessor["count"] for accessor in accessors if "bufferView" not in accessor) > NUMBERS_PER_BYTE * size:
        yield "more vertices than its buffers hold"
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            read = [primitive["attributes"].get("POSITION"), primitive.get("indices")]
            read = [accessors[number] for number in read if number is not None]
            # Without a view of its own, an accessor's numbers are in what is compressed, and zero for who skips that.
            hollow = any("bufferView" not in part for part in read)
            packed = DRACO in primitive.get("extensions", {})
            if packed and hollow and find_spec("DracoPy") is None:
                yield "triangles compressed by Draco"
            if any("sparse" in accessor for accessor in read):
                yield "vertices in sparse accessors"
            if hollow and not packed:
                yield "vertices that are in no buffer"
            if any(accessor.get("normalized") and accessor["componentType"] != FLOAT for accessor in read):
                yield "vertices as normalized integers"
            if primitive.get("mode") == FAN:
                yield "fans of triangles"
    if any(INSTANCES in node.get("extensions", {}) for node in document.get("nodes", [])):
        yield "meshes with many instances"
