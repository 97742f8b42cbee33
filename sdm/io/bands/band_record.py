"""Record beside the blocks of a band."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import Tensor

from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError
from sdm.io.maps.record import HOLE_SIZE, SIGN_METHOD, TRUNCATED, from_record, record

ARRAYS = {"blocks": np.int32, "values": np.float32, "inside": np.int32}


def band_record(band: SparseSDM, made_from: str | None) -> dict[str, Any]:
    """Geometry, width, counts and sign of a band, and the digest of its mesh, ready for JSON."""
    signs: dict[str, Any] = {TRUNCATED: band.width} | ({} if band.sign is None else {SIGN_METHOD: band.sign})
    signs |= {} if band.hole_size is None else {HOLE_SIZE: band.hole_size}
    return record(band.grid, band.ambiguous_voxels, made_from, signs)


def arrays_of(band: SparseSDM) -> dict[str, np.ndarray]:
    """The arrays of a band on the host."""
    return {
        name: getattr(band, name).detach().cpu().numpy().astype(dtype, copy=False) for name, dtype in ARRAYS.items()
    }


def band_from(kept: Any, arrays: dict[str, Tensor], name: str) -> SparseSDM:
    """The band that a record and its arrays were written for.

    Raises:
        FormatError: They do not fit each other.
    """
    grid, count = from_record(kept, name)
    sign, hole = kept.get(SIGN_METHOD), kept.get(HOLE_SIZE)
    hole = None if hole is None else float(hole)
    band = SparseSDM(
        **arrays, grid=grid, width=float(kept[TRUNCATED]), ambiguous_voxels=count, sign=sign, hole_size=hole
    )
    if not bool((band.keys[1:] > band.keys[:-1]).all()):
        raise FormatError(f"{name} is damaged: its blocks are not sorted")
    return band
