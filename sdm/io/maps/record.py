"""Record beside the values of a map: its exact geometry in float64, and the digest of its mesh."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import torch
from isal import isal_zlib

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.normalization import Normalization
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.io.files.checksum import checksum_of, mesh_digest

VERSION = 1
# Under this name, where a format has names.
KEY = "sdm"
# The same of a narrow band.
BAND_KEY = "sdm_band"
# In it, the digest of the mesh, where it is known.
MADE_FROM = "made_from"
# In it, the method by which the map is signed, and what belongs to it, where it is known.
SIGN_METHOD, HOLE_SIZE, DISAGREEMENTS = "sign_method", "hole_size", "sign_disagreements"
# In it, the length at which distances are cut, and what the mesh went through before, in words.
TRUNCATED, NORMALIZATION = "truncated", "normalization"
# In it, the checksum of values and record, for formats that have none of their own.
CHECKSUM = "crc32"
# In its place until the values are looked at.
OPEN = "00000000"
# In it, the checksum of the record alone. A damaged geometry would otherwise look as if another program had moved the
# image, whose values nobody can then vouch for.
RECORD_CHECKSUM = "record_crc32"
NO_VALUES = np.zeros(0, np.float32)


def digest_of(mesh: TriangleMesh, how: str = "") -> str:
    """Digest of a mesh: the same for the same triangles in the same order, facing the same way.

    Args:
        mesh: The mesh.
        how: What else a map depends on, besides the grid.
    """
    return mesh_digest(*mesh.numpy(), how)


def record(
    grid: Grid, ambiguous_voxels: int | None, made_from: str | None = None, signs: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Geometry, counts, `signs_of` and `digest_of` the mesh of a map, ready for JSON, which keeps all of a float64."""
    found = {
        "version": VERSION,
        "origin": list(grid.origin),
        "spacing": list(grid.spacing),
        "shape": list(grid.shape),
        "direction": [list(row) for row in grid.direction],
        "ambiguous_voxels": ambiguous_voxels,
        "sign": "negative inside",
        **(signs or {}),
    }
    return found if made_from is None else {**found, MADE_FROM: made_from}


def signs_of(field: SDM) -> dict[str, Any]:
    """The part of a map's record that says how it is signed, cut and placed: what is known of it."""
    return signs_record(
        field.sign, field.hole_size, field.truncated, field.normalization, disagreements=field.sign_disagreements
    )


def signs_record(
    sign: str | None,
    hole_size: float | None,
    truncated: float | None,
    normalization: Normalization | None,
    *,
    disagreements: int | None = None,
) -> dict[str, Any]:
    """The same of a map that is not there yet."""
    found = {
        SIGN_METHOD: sign,
        HOLE_SIZE: hole_size,
        DISAGREEMENTS: disagreements,
        TRUNCATED: truncated,
        NORMALIZATION: None if normalization is None else str(normalization),
    }
    return {key: value for key, value in found.items() if value is not None}


def stored_values(field: SDM) -> np.ndarray:
    """Values (nx,ny,nz) on the host for a format that has half precision: float16 if the map's are, else float32."""
    if field.values.dtype == torch.float16:
        return field.values.detach().cpu().numpy()
    return field.numpy().astype(np.float32, copy=False)


def sign_arguments(kept: Any) -> dict[str, Any]:
    """The arguments of `SDM` that a record tells by what `signs_of` gave."""
    kept = kept if isinstance(kept, dict) else {}
    hole, count = kept.get(HOLE_SIZE), kept.get(DISAGREEMENTS)
    cut, moved = kept.get(TRUNCATED), kept.get(NORMALIZATION)
    return {
        "sign": kept.get(SIGN_METHOD),
        "hole_size": None if hole is None else float(hole),
        "sign_disagreements": None if count is None else int(count),
        "truncated": None if cut is None else float(cut),
        "normalization": None if moved is None else Normalization.parse(moved),
    }


def with_checksum(kept: dict[str, Any], values: np.ndarray) -> dict[str, Any]:
    """A record with checksums: of itself, and of itself with values (nx,ny,nz) float32, which may be none."""
    kept, begin = with_open_checksum(kept)
    return {**kept, CHECKSUM: checksum_of(values, begin)}


def with_open_checksum(kept: dict[str, Any]) -> tuple[dict[str, Any], int]:
    """The same with zeros for the checksum of the values, and the number that `checksum_of` begins with to find it."""
    kept = {**kept, RECORD_CHECKSUM: _checksum(kept, NO_VALUES)}
    return {**kept, CHECKSUM: OPEN}, _begin(kept)


def verify(kept: Any, values: np.ndarray, name: str) -> None:
    """Compare values (nx,ny,nz) float32, and the record itself, with the record's checksum, if it has one.

    Raises:
        FormatError: They are not what was written.
    """
    if not isinstance(kept, dict) or CHECKSUM not in kept:
        return
    found = {key: value for key, value in kept.items() if key != CHECKSUM}
    if _checksum(found, values) != kept[CHECKSUM]:
        raise FormatError(
            f"{name} is not what sdm wrote: it is damaged, or another program changed its values and kept their "
            "checksum; compute or copy it again"
        )


def _verify_record(kept: dict[str, Any], name: str) -> None:
    found = {key: value for key, value in kept.items() if key not in (CHECKSUM, RECORD_CHECKSUM)}
    # They are written together: one alone has lost the other.
    whole = (CHECKSUM in kept) == (RECORD_CHECKSUM in kept)
    if not whole or (RECORD_CHECKSUM in kept and _checksum(found, NO_VALUES) != kept[RECORD_CHECKSUM]):
        raise FormatError(f"{name} is damaged: its record is not what sdm wrote; compute or copy it again")


def _checksum(kept: dict[str, Any], values: np.ndarray) -> str:
    return checksum_of(values, _begin(kept))


def _begin(kept: dict[str, Any]) -> int:
    return isal_zlib.crc32(to_line(dict(sorted(kept.items()))).encode())


def to_line(kept: dict[str, Any]) -> str:
    """One line of JSON."""
    return json.dumps(kept, separators=(",", ":"))


def from_record(found: Any, name: str) -> tuple[Grid, int | None]:
    """The geometry and the number of ambiguous voxels that a file called `name` keeps.

    Raises:
        FormatError: It keeps something else.
    """
    if not isinstance(found, dict) or "version" not in found:
        raise FormatError(f"{name} was not written by sdm: it does not say where its values are")
    if found["version"] > VERSION:
        raise FormatError(f"{name} was written by a newer version of sdm: update it to read this file")
    _verify_record(found, name)
    count = found["ambiguous_voxels"]
    grid = Grid(found["origin"], found["spacing"], found["shape"], found["direction"])
    return grid, None if count is None else int(count)
