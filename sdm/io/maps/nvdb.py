"""`.nvdb` by Warp: NanoVDB, read by renderers and simulators.

Warp sets a volume's transform in float32 and knows no metadata, so the double-precision transform that NanoVDB has room
for is filled in here, and the grid's name (at most 255 letters) keeps the exact geometry:
`sdm NXxNYxNZ AMBIGUOUS BASE64`, where BASE64 is origin, spacing and direction as 15 little-endian float64 numbers. If
the mesh is known, a space and its digest follow.
Voxels come in blocks of 8 x 8 x 8; those beyond the map have its largest value, and so have blocks that are not kept
because nothing in them is less. The volume is compressed, so that the file of a map of 24^3 voxels or more is smaller
than the bare values; header and tree of a smaller one take up to 3 kB more, and a map of few layers has voxels beyond
it in each block.
"""

from __future__ import annotations

import base64
import math
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from isal import isal_zlib

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, one_line
from sdm.io.maps.record import DISAGREEMENTS, HOLE_SIZE, MADE_FROM, SIGN_METHOD, TRUNCATED, sign_arguments
from sdm.kernels.nanovdb import lookup, store

BLOCK = 8
NAME = re.compile(r"sdm (\d+)x(\d+)x(\d+) (\d+|-) ([A-Za-z0-9+/=]+)(?: ([0-9a-f]+))?(?: ([WFN])(\d*))?")
SIGNS = {"W": "winding", "F": "flood", "N": "none"}
# A 16th number is the size of holes, NaN for none; a 17th the length at which distances are cut.
HOLE, CUT = 15, 16
# Layers of voxels that go between NumPy and Warp at a time.
LAYERS = 64
LEVEL_SET = 1
# Of 0 to 3. Distances hardly shrink by more work.
LEVEL = 1
# Of zlib's, 0 to 9.
THOROUGH = 9

# Bytes of NanoVDB's GridData, and of the file's headers before it.
NAME_AT, NAME_SIZE = 40, 256
DOUBLE_MAP_AT = NAME_AT + NAME_SIZE + 88
VOXEL_SIZE_AT, CLASS_AT = 608, 632
FILE_NAME_SIZE_AT, FILE_NAME_AT = 16 + 136, 16 + 176
# What a volume begins with, and bytes of it, compressed or not, that hold its name.
MAGIC, NAME_READ = b"NanoVDB", 1 << 14
# The codec, of the file and of the grid, and the bytes that the grid takes in the file.
CODECS_AT, FILE_SIZE_AT, ZIP = (14, 16 + 168), 16 + 8, 1


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write a map as a level set.

    Raises:
        FormatError: Warp cannot make such a volume.
    """
    grid, values = field.grid, field.numpy().astype(np.float32, copy=False)
    try:
        volume = _volume(grid, values)
    except RuntimeError as error:
        raise FormatError(f"Warp cannot make a NanoVDB volume of shape {grid.shape}: {one_line(error)}") from error
    for begin in range(0, len(values), LAYERS):
        slab = np.ascontiguousarray(values[begin : begin + LAYERS])
        store(volume, begin, wp.array(slab, dtype=wp.float32, device="cpu", copy=False))
    complete_header(volume.array().numpy().view(np.uint8), field, made_from)
    volume.save_to_nvdb(str(path))
    compress(path, grid.nbytes)


def read(path: Path) -> SDM:
    """Read a map that sdm wrote."""
    grid, count = geometry(path)
    with path.open("rb") as file:
        volume = wp.Volume.load_from_nvdb(file, device="cpu")
    values = np.empty(grid.shape, dtype=np.float32)
    for begin in range(0, len(values), LAYERS):
        slab = wp.array(values[begin : begin + LAYERS], dtype=wp.float32, device="cpu", copy=False)
        lookup(volume, begin, slab)
    return SDM(torch.from_numpy(values), grid, count, **sign_arguments(read_record(path)))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone."""
    return geometry(path)[0]


def read_record(path: Path, pattern: re.Pattern[str] = NAME) -> Any:
    """Read what is kept beside the values, but for the geometry."""
    *_, packed, digest, letter, differ = _named(path, pattern)
    numbers = np.frombuffer(base64.b64decode(packed), "<f8").tolist()
    hole = numbers[HOLE] if len(numbers) > HOLE and not math.isnan(numbers[HOLE]) else None
    cut = numbers[CUT] if len(numbers) > CUT else None
    signs = {SIGN_METHOD: SIGNS.get(letter), HOLE_SIZE: hole, DISAGREEMENTS: differ or None}
    return {MADE_FROM: digest, TRUNCATED: cut, **signs}


def _volume(grid: Grid, values: np.ndarray) -> wp.Volume:
    corners = np.meshgrid(*(np.arange(0, n, BLOCK, dtype=np.int32) for n in grid.shape), indexing="ij")
    tiles = np.stack(corners, -1).reshape(-1, 3)
    finite = values[np.isfinite(values)]
    if finite.size == values.size:
        kept = tiles[_least_of_blocks(values).ravel() < finite.max()]
        # A volume has at least one.
        tiles = kept if len(kept) else tiles[:1]
    return wp.Volume.allocate_by_tiles(
        wp.array(tiles, dtype=wp.vec3i, device="cpu"),
        bg_value=float(finite.max()) if finite.size else 0.0,
        translation=grid.origin,
        transform=wp.mat33f(*grid.affine[:3, :3].ravel().tolist()),
        device="cpu",
    )


def _least_of_blocks(values: np.ndarray) -> np.ndarray:
    """The least value of each block of 8 x 8 x 8, those at the far ends of the axes being as small as the map is."""
    for axis, length in enumerate(values.shape):
        values = np.minimum.reduceat(values, np.arange(0, length, BLOCK), axis=axis)
    return values


def compress(path: Path, plain: int) -> None:
    """Compress the volume in a file that Warp wrote, whose own way to do it takes ten times as long.

    Where that is more than `plain` bytes, as of small maps, whose tree is most of it, zlib does it thoroughly.
    """
    data = path.read_bytes()
    at = FILE_NAME_AT + struct.unpack_from("<I", data, FILE_NAME_SIZE_AT)[0]
    packed = isal_zlib.compress(memoryview(data)[at:], LEVEL)
    if at + 8 + len(packed) > plain:
        packed = min(packed, zlib.compress(memoryview(data)[at:], THOROUGH), key=len)
    head = bytearray(data[:at])
    for place in CODECS_AT:
        struct.pack_into("<H", head, place, ZIP)
    struct.pack_into("<Q", head, FILE_SIZE_AT, 8 + len(packed))
    with path.open("wb") as file:
        for part in (head, struct.pack("<Q", len(packed)), packed):
            file.write(part)


def complete_header(data: np.ndarray, field: SDM, made_from: str | None, word: str = "sdm") -> None:
    """Write name, which begins with a word, class and double-precision transform into a volume's own bytes."""
    grid = field.grid
    numbers = struct.pack("<15d", *grid.origin, *grid.spacing, *np.ravel(grid.direction))
    if field.hole_size is not None or field.truncated is not None:
        numbers += struct.pack("<d", math.nan if field.hole_size is None else field.hole_size)
    if field.truncated is not None:
        numbers += struct.pack("<d", field.truncated)
    count = "-" if field.ambiguous_voxels is None else str(field.ambiguous_voxels)
    words = [word, "x".join(map(str, grid.shape)), count, base64.b64encode(numbers).decode()]
    words += [] if made_from is None else [made_from]
    letters = [letter for letter, sign in SIGNS.items() if sign == field.sign]
    words += [f"{letter}{'' if field.sign_disagreements is None else field.sign_disagreements}" for letter in letters]
    name = " ".join(words).encode()
    matrix = grid.affine[:3, :3]
    transform = np.concatenate([matrix.ravel(), np.linalg.inv(matrix).ravel(), grid.origin, [1.0]])
    size = np.asarray(grid.spacing, dtype="<f8")
    for place, content in (
        (NAME_AT, name.ljust(NAME_SIZE, b"\0")),
        (DOUBLE_MAP_AT, transform.astype("<f8").tobytes()),
        (VOXEL_SIZE_AT, size.tobytes()),
        (CLASS_AT, struct.pack("<I", LEVEL_SET)),
    ):
        data[place : place + len(content)] = np.frombuffer(content, dtype=np.uint8)


def geometry(path: Path, pattern: re.Pattern[str] = NAME) -> tuple[Grid, int | None]:
    """Geometry of a map, and how many voxels are ambiguous."""
    *shape, count, packed, _, _, _ = _named(path, pattern)
    numbers = struct.unpack_from("<15d", base64.b64decode(packed))
    grid = Grid(numbers[:3], numbers[3:6], [int(n) for n in shape], np.reshape(numbers[6:], (3, 3)))
    return grid, None if count == "-" else int(count)


def _named(path: Path, pattern: re.Pattern[str]) -> tuple[str, ...]:
    """The parts of the grid's name; the last three are None where mesh, sign and count of disagreements are unknown."""
    name = grid_name(path)
    found = pattern.fullmatch(name)
    if found is None:
        raise FormatError(f"{path} was not written by sdm: it does not say where its values are")
    if name != _name_in_volume(path):
        raise FormatError(
            f"{path} is damaged: the name in its head is not the one in its volume; compute or copy it again"
        )
    return found.groups()


def grid_name(path: Path) -> str:
    """The name of a file's grid."""
    with path.open("rb") as file:
        head = file.read(FILE_NAME_AT + NAME_SIZE + 1)
    size = struct.unpack_from("<I", head, FILE_NAME_SIZE_AT)[0]
    return head[FILE_NAME_AT : FILE_NAME_AT + size].split(b"\0")[0].decode("latin-1")


def _name_in_volume(path: Path) -> str | None:
    """The name that the volume itself has, whose bytes zlib's checksum holds together; None where it cannot be read.

    A file's head repeats it, and has no checksum.
    """
    with path.open("rb") as file:
        size = struct.unpack_from("<I", file.read(FILE_NAME_AT), FILE_NAME_SIZE_AT)[0]
        file.seek(FILE_NAME_AT + size)
        content = file.read(NAME_READ)
    if not content.startswith(MAGIC):
        # Compressed, behind its length.
        try:
            content = zlib.decompressobj().decompress(content[8:], NAME_AT + NAME_SIZE)
        except zlib.error:
            return None
    return content[NAME_AT : NAME_AT + NAME_SIZE].split(b"\0")[0].decode("latin-1")
