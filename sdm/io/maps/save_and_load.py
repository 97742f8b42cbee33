"""Signed distance maps to files and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import torch

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.device import require_memory
from sdm.core.given_values import as_path
from sdm.core.grid import Grid
from sdm.core.normalization import Normalization
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError, GridError, SDMError, one_line
from sdm.io.bands.save_and_load import band_origin, is_band, read_band, save_band
from sdm.io.files.atomic import replacing
from sdm.io.files.remote import is_remote, local_copy, local_for
from sdm.io.maps.formats import (
    FORMATS,
    HEADERS,
    Format,
    check_normalized,
    check_target,
    format_of,
    require_memory_to_write,
)
from sdm.io.maps.record import MADE_FROM, signs_record

if TYPE_CHECKING:
    from torch import Tensor

    from sdm.engine.arguments import Sign
    from sdm.engine.mesh_index import MeshIndex
    from sdm.runtime.worker_processes.pool import WorkerProcesses


# What worker processes run that write maps.
WRITE = "sdm.io.files.atomic:replace_by"


class VoxelCounts(NamedTuple):
    """Counts of a map's voxels, as in `SDM`: those that are inside, and those that are ambiguous."""

    inside: int
    ambiguous: int


def save(field: SDM | SparseSDM, path: str | Path) -> None:
    """Write a map to `.npz`, `.nii`, `.nii.gz`, `.nrrd`, `.mha`, `.mhd`, `.vti`, `.zarr` or `.nvdb`, as the name ends.

    Args:
        field: The map, on any device; values are written as float32. A narrow band goes to `.npz`, `.zarr` or `.nvdb`.
        path: Where to. What is there is replaced once the new file is whole. An address, such as `s3://bucket/map.npz`
            (extra `remote`), is written to as its server does it.

    `load` gives the same values and, to the last bit, the same geometry. A process killed on the way leaves what was
    there before, and a hidden file whose name ends in `.part`.

    Raises:
        FormatError: An ending that is not known, or a place that cannot be written.
    """
    if is_remote(path):
        with local_for(str(path)) as local:
            save(field, local)
        return
    if isinstance(field, SparseSDM):
        save_band(field, as_path(path))
        return
    save_made_from(field, as_path(path), None)


def save_made_from(field: SDM, target: Path, made_from: str | None) -> None:
    """As `save`, with the digest of the mesh that the map is made from; see `made_from`."""
    check_target(target)
    write_made_from(field, target, made_from)


def write_made_from(
    field: SDM, target: Path, made_from: str | None, *, workers: WorkerProcesses | None = None
) -> int | None:
    """As `save_made_from`, to a place that `check_target` has looked at, by processes that run `WRITE` if they can.

    Returns:
        The number of voxels inside, where such a process has counted them.
    """
    if not isinstance(field, SDM):
        raise SDMError(f"an object of type {type(field).__name__} is no map: give an SDM or a SparseSDM")
    chosen = format_of(target)
    if field.normalization is not None:
        check_normalized(target)
    if workers is not None and chosen.alone:
        return workers.call(target, *chosen.module.planned_unseen(field, made_from))
    with replacing(target) as part:
        getattr(chosen.module, chosen.writer)(field, part, made_from)
    return None


def load(path: str | Path) -> SDM:
    """Read a map that `save` wrote, or a NIfTI, NRRD, MetaImage or VTI image of three dimensions, onto the host.

    An address, such as `s3://bucket/map.npz`, is read with the extra `remote`. A file of a narrow band gives a
    `SparseSDM`; `load_band` takes no other files, and is typed so.

    Raises:
        FormatError: No such file, an ending that is not known, or a file that is damaged or not a map.
    """
    if is_remote(path):
        with local_copy(str(path)) as local:
            return load(local)
    source = as_path(path)
    chosen = _readable(source, FORMATS)
    with _reading(source):
        if is_band(source):
            # Most files hold maps, and most callers would have to ask which they have.
            return cast("SDM", read_band(source))
        grid = chosen.module.read_grid(source)
        require_memory(grid.nbytes, torch.device("cpu"), f"a map of {' x '.join(map(str, grid.shape))} voxels")
        return chosen.module.read(source)


def load_band(path: str | Path) -> SparseSDM:
    """Read a narrow band that `save` wrote, onto the host.

    Raises:
        FormatError: As `load`, or a file of a map.
    """
    source = as_path(path)
    _readable(source, FORMATS)
    with _reading(source):
        if not is_band(source):
            raise FormatError(f"{source} has no narrow band; sdm.load reads maps")
        return read_band(source)


def grid_like(path: str | Path | Any) -> Grid:
    """The geometry of a NIfTI, NRRD or MetaImage file, or of a map that `save` wrote, without reading the values.

    An image of another library is taken in place of a path, as `sdm.core.as_grid` takes it.

    World coordinates are taken as right-anterior-superior: an NRRD image in left-posterior-superior space gives the
    grid that the same image gives as NIfTI.

    Raises:
        FormatError: As `load`.
        GridError: The image's axes are not orthogonal.
    """
    if not isinstance(path, str | Path):
        return as_grid(path)
    source = as_path(path)
    chosen = _readable(source, FORMATS | HEADERS)
    with _reading(source):
        return band_origin(source)[0] if is_band(source) else chosen.module.read_grid(source)


def is_placed(path: str | Path) -> bool:
    """True if an image says how it lies in space: a NIfTI image with neither qform nor sform does not.

    Raises:
        FormatError: As `load`.
    """
    source = as_path(path)
    chosen = _readable(source, FORMATS | HEADERS)
    with _reading(source):
        return not hasattr(chosen.module, "is_placed") or chosen.module.is_placed(source)


def made_from(path: str | Path) -> str | None:
    """Digest of the mesh that a map is made from, if `write_streamed` was told; else None, as for other images.

    Raises:
        FormatError: As `load`.
    """
    source = as_path(path)
    chosen = _readable(source, FORMATS)
    with _reading(source):
        if is_band(source):
            return band_origin(source)[1]
        found = chosen.module.read_record(source)
    return found.get(MADE_FROM) if isinstance(found, dict) else None


def write_streamed(
    index: MeshIndex,
    grid: GridLike,
    path: str | Path,
    *,
    progress: Callable[[float], Any] | None = None,
    made_from: str | None = None,
    sign: Sign = "winding",
    hole_size: float | None = None,
    stored: Callable[[Tensor], Tensor] | None = None,
    truncated: float | None = None,
    normalization: Normalization | None = None,
) -> VoxelCounts:
    """Compute a map and write it; `.zarr` slab by slab, so that the grid may be larger than memory.

    Args:
        index: The mesh.
        grid: Where to measure: a `Grid`, an image, or voxels along each axis of a grid around the mesh.
        path: Where to write, as for `save`.
        progress: Called with the share that is done, 0 to 1; for formats other than `.zarr` at the end alone.
        made_from: `digest_of` the mesh, which the file is to keep; see `made_from`.
        sign: As for `sdm.signed_distance_map`. A flood's map has to fit into memory, whatever the format.
        hole_size: Of a flood.
        stored: Makes of values what the file is to have, such as half precision.
        truncated: The length at which it cuts them, for the file's record.
        normalization: What the mesh was normalised by, for the same.

    Returns:
        How many voxels are inside, and how many are ambiguous: of a closed mesh none.

    Raises:
        FormatError: As `save`, before anything is computed.
        GridError: Not `.zarr`, and the map does not fit into memory.
    """
    # Its package needs what reading and writing does not.
    from sdm.engine.arguments import SignMethod

    # Whatever gives a map in slabs will do.
    if not hasattr(index, "slabs"):
        raise SDMError(f"an object of type {type(index).__name__} is no index of a mesh: give a sdm.MeshIndex")
    asked: dict[str, Any] = {} if sign == "winding" and hole_size is None else {"sign": sign, "hole_size": hole_size}
    target, grid = as_path(path), as_grid(grid, index.mesh)
    chosen = check_target(target)
    require_memory_to_write(chosen, grid, index.device)
    if not chosen.streamed:
        field = index.signed_distance_map(grid, **asked)
        more = {"truncated": truncated, "normalization": normalization}
        if stored is not None or any(value is not None for value in more.values()):
            kept = {"sign": field.sign, "hole_size": field.hole_size, **more}
            field = SDM(field.values if stored is None else stored(field.values), grid, field.ambiguous_voxels, **kept)
        save_made_from(field, target, made_from)
        if progress is not None:
            progress(1.0)
        return VoxelCounts(field.inside_voxels, field.ambiguous_voxels or 0)
    inside, unclear = torch.zeros(2, dtype=torch.int64, device=index.device)
    with replacing(target) as part:
        layer_bytes = 4 * grid.shape[1] * grid.shape[2]
        size = chosen.module.slab_layers(grid) * layer_bytes
        slabs = index.slabs(grid, max_bytes=size, ambiguous=unclear, **asked)
        hole = SignMethod(sign, hole_size).hole_on(grid) if sign == "flood" else None
        signs = signs_record(sign, hole, truncated, normalization)
        told = _told(slabs, grid.shape[0], progress, inside, stored or (lambda values: values))
        dtype = "float32" if stored is None else str(stored(torch.zeros(1, device="cpu")).dtype).removeprefix("torch.")
        count = (lambda: int(unclear)) if sign == "winding" else (lambda: None)
        chosen.module.write_slabs(told, grid, part, count, made_from, signs, dtype)
    return VoxelCounts(int(inside), int(unclear))


def _told(
    slabs: Iterator[tuple[int, int, Tensor]],
    layers: int,
    progress: Callable[[float], Any] | None,
    inside: Tensor,
    stored: Callable[[Tensor], Tensor],
) -> Iterator[tuple[int, int, Tensor]]:
    for begin, end, exact in slabs:
        values = stored(exact)
        del exact
        inside += (values < 0).sum()
        yield begin, end, values
        del values
        if progress is not None:
            progress(end / layers)


def _readable(path: Path, formats: dict[str, Format]) -> Format:
    with _reading(path):
        if not path.exists():
            raise FormatError(f"there is no file {path}")
    return format_of(path, formats)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Errors of libraries about a damaged file, in one sentence."""
    try:
        yield
    except GridError as error:
        # Of a grid it is said what is wrong with it, but not whose it is.
        raise GridError(f"{path}: {error}") from error
    except (SDMError, MemoryError):
        raise
    except OSError as error:
        raise FormatError(f"{path} cannot be read: {one_line(error.strerror or error)}") from error
    # Parsers of damaged files raise whatever they come across.
    except Exception as error:
        why = one_line(error)
        raise FormatError(f"{path} cannot be read; it is damaged, or not what its name says ({why})") from error
