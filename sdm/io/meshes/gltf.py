"""glTF files of which trimesh would make something else without a word: what it passes over."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sdm.errors import MeshError

GLB, GLB_HEADER, CHUNK_HEADER = b"glTF", 12, 8
DRACO = "KHR_draco_mesh_compression"
INSTANCES = "EXT_mesh_gpu_instancing"
FLOAT, FAN = 5126, 6


def check_gltf(path: Path, data: bytes) -> None:
    """Look for triangles that trimesh would lose or put elsewhere.

    Raises:
        MeshError: There are some.
    """
    try:
        reason = next(_reasons(json.loads(_text(data))), None)
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


def _reasons(document: Any) -> Iterator[str]:
    accessors = document.get("accessors", [])
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            read = [primitive["attributes"].get("POSITION"), primitive.get("indices")]
            read = [accessors[number] for number in read if number is not None]
            # Without a view of its own, an accessor's numbers are in what is compressed, and zero for who skips that.
            packed = DRACO in primitive.get("extensions", {}) and any("bufferView" not in part for part in read)
            if packed and find_spec("DracoPy") is None:
                yield "triangles compressed by Draco"
            if any("sparse" in accessor for accessor in read):
                yield "vertices in sparse accessors"
            if any(accessor.get("normalized") and accessor["componentType"] != FLOAT for accessor in read):
                yield "vertices as normalized integers"
            if primitive.get("mode") == FAN:
                yield "fans of triangles"
    if any(INSTANCES in node.get("extensions", {}) for node in document.get("nodes", [])):
        yield "meshes with many instances"
