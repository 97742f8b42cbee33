"""What every format keeps beside the values: the exact geometry, in float64."""

from __future__ import annotations

import json
from typing import Any

from sdm.errors import FormatError
from sdm.grid import Grid

VERSION = 1
# Under this name, where a format has names.
KEY = "sdm"


def record(grid: Grid, ambiguous_voxels: int | None) -> dict[str, Any]:
    """Geometry and counts of a map, ready for JSON, which keeps every digit of a float64."""
    return {
        "version": VERSION,
        "origin": list(grid.origin),
        "spacing": list(grid.spacing),
        "shape": list(grid.shape),
        "direction": [list(row) for row in grid.direction],
        "ambiguous_voxels": ambiguous_voxels,
        "sign": "negative inside",
    }


def to_text(grid: Grid, ambiguous_voxels: int | None) -> str:
    """`record` as one line of JSON."""
    return json.dumps(record(grid, ambiguous_voxels), separators=(",", ":"))


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
