"""What every format keeps beside the values: the exact geometry, in float64, and which mesh the map is of."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError

VERSION = 1
# Under this name, where a format has names.
KEY = "sdm"
# In it, the digest of the mesh, where it is known.
MADE_FROM = "made_from"
# Hexadecimal digits.
DIGEST = 32


def digest_of(mesh: TriangleMesh) -> str:
    """What meshes of the same triangles, in the same order and facing the same way, have in common."""
    vertices, faces = mesh.numpy()
    digest = hashlib.sha256(f"{vertices.shape} {faces.shape}".encode())
    digest.update(vertices.astype("<f4", copy=False).tobytes())
    digest.update(faces.astype("<i4", copy=False).tobytes())
    return digest.hexdigest()[:DIGEST]


def record(grid: Grid, ambiguous_voxels: int | None, made_from: str | None = None) -> dict[str, Any]:
    """Geometry, counts and `digest_of` the mesh of a map, ready for JSON, which keeps every digit of a float64."""
    found = {
        "version": VERSION,
        "origin": list(grid.origin),
        "spacing": list(grid.spacing),
        "shape": list(grid.shape),
        "direction": [list(row) for row in grid.direction],
        "ambiguous_voxels": ambiguous_voxels,
        "sign": "negative inside",
    }
    return found if made_from is None else {**found, MADE_FROM: made_from}


def to_text(grid: Grid, ambiguous_voxels: int | None, made_from: str | None = None) -> str:
    """`record` as one line of JSON."""
    return json.dumps(record(grid, ambiguous_voxels, made_from), separators=(",", ":"))


def from_record(found: Any, name: str) -> tuple[Grid, int | None]:
    """The geometry and the number of ambiguous voxels that a file called `name` keeps.

    Raises:
        FormatError: It keeps something else.
    """
    if not isinstance(found, dict) or "version" not in found:
        raise FormatError(f"{name} was not written by sdm: it does not say where its values are")
    if found["version"] > VERSION:
        raise FormatError(f"{name} was written by a newer version of sdm: update it to read this file")
    count = found["ambiguous_voxels"]
    grid = Grid(found["origin"], found["spacing"], found["shape"], found["direction"])
    return grid, None if count is None else int(count)


def from_text(text: str, name: str) -> tuple[Grid, int | None]:
    """`from_record` of one line of JSON."""
    return from_record(json.loads(text), name)
