"""Bands in `.nvdb`: a sparse NanoVDB level set, with tiles inside, in a file as `sdm.io.maps.nvdb` writes for maps.

The grid's name begins with `sdmband` in place of `sdm`; the last of its numbers is the width.
"""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp

from sdm.core.block_lookup import blocks_along, joined_runs, keys_of
from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError, one_line
from sdm.io.bands.volume import inside_of, nodes_of, volume_of
from sdm.io.maps import nvdb
from sdm.io.maps.record import HOLE_SIZE, MADE_FROM, SIGN_METHOD, TRUNCATED

WORD = "sdmband"
NAME = re.compile(nvdb.NAME.pattern.replace("sdm ", f"{WORD} ", 1))


def write(band: SparseSDM, path: Path, made_from: str | None = None) -> None:
    """Write a band.

    Raises:
        FormatError: Warp cannot make such a volume.
    """
    try:
        volume = volume_of(band.cpu())
    except RuntimeError as error:
        raise FormatError(f"Warp cannot make a NanoVDB volume of shape {band.shape}: {one_line(error)}") from error
    told: Any = SimpleNamespace(
        grid=band.grid,
        hole_size=band.hole_size,
        truncated=band.width,
        ambiguous_voxels=band.ambiguous_voxels,
        sign=band.sign,
        sign_disagreements=None,
    )
    nvdb.complete_header(volume.array().numpy(), told, made_from, WORD)
    volume.save_to_nvdb(str(path))
    nvdb.compress(path, band.values.nbytes)


def read(path: Path) -> SparseSDM:
    """Read a band that sdm wrote."""
    grid, count = nvdb.geometry(path, NAME)
    kept = nvdb.read_record(path, NAME)
    width = float(kept[TRUNCATED])
    with path.open("rb") as file:
        volume = wp.Volume.load_from_nvdb(file, device="cpu")
    nodes = nodes_of(volume)
    blocks, values = nodes.blocks, nodes.values
    order = keys_of(blocks, blocks_along(grid.shape)).argsort()
    blocks, values = blocks[order], values[order]
    # A volume has at least one leaf, a band may have no block.
    near = (values.abs() < width).flatten(1).any(1)
    leaf = blocks[~near & (values[:, 0, 0, 0] < 0)]
    inside = torch.cat([inside_of(nodes, grid), torch.cat([leaf, leaf[:, 2:] + 1], 1)])
    inside = joined_runs(inside, blocks_along(grid.shape))
    hole = kept.get(HOLE_SIZE)
    hole = None if hole is None else float(hole)
    return SparseSDM(blocks[near], values[near], inside, grid, width, count, kept[SIGN_METHOD], hole)


def read_origin(path: Path) -> tuple[Grid, str | None]:
    """The grid, and the digest of the mesh."""
    return nvdb.geometry(path, NAME)[0], nvdb.read_record(path, NAME)[MADE_FROM]


def is_band(path: Path) -> bool:
    """True if a file has a band."""
    return nvdb.grid_name(path).startswith(f"{WORD} ")
