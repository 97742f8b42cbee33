"""The formats of signed distance maps, by the end of the file's name."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import torch

from sdm.core.device import free_memory, gibibytes, require_memory
from sdm.core.given_values import as_path
from sdm.core.grid import Grid
from sdm.errors import FormatError, GridError
from sdm.io.files.atomic import try_to_write
from sdm.io.maps.record import BAND_KEY, KEY

# Bytes that are always there; asking takes time.
SMALL = 1 << 26
# What makes a folder a Zarr array or group.
METADATA = "zarr.json"


@dataclass(frozen=True)
class Format:
    """A file format.

    Args:
        name: The file of this package with `read`, `read_grid` and the writer.
        extra_maps: Memory that writing takes beyond the map on the host, in maps.
        writer: The writer's name.
        streamed: Whether the writer takes a map slab by slab, into a folder.
        alone: Whether `planned_unseen` of that file says how a map is written without torch. Of what is packed: what is
            only written gains nothing by processes of its own.
        normalized: Whether a file has room for what a mesh was normalised by.
    """

    name: str
    extra_maps: float = 0.0
    writer: str = "write"
    streamed: bool = False
    alone: bool = False
    normalized: bool = True

    @property
    def module(self) -> ModuleType:
        """The format's file, whose libraries are loaded when they are needed."""
        return importlib.import_module(f"sdm.io.maps.{self.name}")


FORMATS = {
    "nii.gz": Format("nifti", writer="write_compressed", alone=True),
    "nii": Format("nifti"),
    "npz": Format("npz"),
    "nrrd": Format("nrrd", extra_maps=1.0),
    "mha": Format("metaimage", extra_maps=1.0),
    "mhd": Format("metaimage", extra_maps=1.0),
    "vti": Format("vti", extra_maps=2.0),
    "zarr": Format("zarr", streamed=True),
    "nvdb": Format("nvdb", extra_maps=4.5, normalized=False),
}
# Images of which the geometry alone is read: the header of an NRRD image whose values lie in another file.
HEADERS = {"nhdr": Format("nrrd")}


def format_of(path: Path, formats: dict[str, Format] = FORMATS) -> Format:
    """The format that a file's name ends with.

    Raises:
        FormatError: None of them.
    """
    found = _named(path, formats)
    if found is None:
        raise FormatError(f"{path} does not end like a map: use one of .{', .'.join(formats)}")
    return found


def check_normalized(path: Path) -> None:
    """Refuse a file that has no room for what a mesh was normalised by.

    Raises:
        FormatError: It is one, or does not end like a map.
    """
    if not format_of(path).normalized:
        raise FormatError(f"{path} has no room for what a mesh was normalised by: use another format than .nvdb")


def is_map_name(path: Path) -> bool:
    """True if a file's name ends like a map."""
    return _named(path, FORMATS) is not None


def _named(path: Path, formats: dict[str, Format]) -> Format | None:
    for ending, found in formats.items():
        if path.name.lower().endswith(f".{ending}") and len(path.name) > len(ending) + 1:
            return found
    return None


def check_target(path: str | Path) -> Format:
    """The format of a file to write, if it can be written there.

    Raises:
        FormatError: The ending is not known, the folder is not there or cannot be written, or something of another
            kind has that name.
    """
    target = as_path(path)
    found = check_target_name(target)
    try_to_write(target)
    return found


def check_target_name(path: Path) -> Format:
    """The format of a file to write in a folder that is known to take files.

    Raises:
        FormatError: The ending is not known, or something of another kind has that name.
    """
    found = format_of(path)
    if is_folder(path):
        if not (found.streamed and (path / METADATA).is_file()):
            raise FormatError(f"{path} cannot be written: a folder of that name is there; choose another name")
        if not _is_map(path):
            raise FormatError(f"{path} cannot be written: what is there is no map of sdm; choose another name")
    return found


def check_file(path: Path) -> None:
    """Find out whether a file of any kind can be written somewhere, before the work whose result it is to hold.

    Raises:
        FormatError: Its folder is not there or cannot be written, or a folder has its name.
    """
    if is_folder(path):
        raise FormatError(f"{path} cannot be written: a folder of that name is there; choose another name")
    try_to_write(path)


def _is_map(path: Path) -> bool:
    """True if a Zarr folder is a map that `sdm.io.maps.zarr` wrote: nothing else is to be replaced."""
    try:
        found = json.loads((path / METADATA).read_bytes())
        # A narrow band is a group of arrays.
        return (KEY if found["node_type"] == "array" else BAND_KEY) in found["attributes"]
    except (OSError, ValueError, TypeError, KeyError):
        return False


def is_folder(path: Path) -> bool:
    """True if a folder is there. A name that the system does not allow names nothing."""
    try:
        return path.is_dir()
    except OSError:
        return False


def require_memory_to_write(chosen: Format, grid: Grid, device: torch.device) -> None:
    """Refuse a map that the host cannot hold while it is written, or whose slabs do not fit.

    Raises:
        GridError: Says how much memory is needed and how much there is.
    """
    host = torch.device("cpu")
    shape = " x ".join(map(str, grid.shape))
    if not chosen.streamed:
        require_memory(int(grid.nbytes * (1 + chosen.extra_maps)), host, f"a map of {shape} voxels")
        return
    layers = min(chosen.module.slab_layers(grid), grid.shape[0])
    needed = 4 * layers * grid.shape[1] * grid.shape[2]
    for where in {host, device}:
        if needed > SMALL and needed > (free := free_memory(where)):
            raise GridError(
                f"a .zarr map of {shape} voxels is computed {layers} layers at a time, which needs "
                f"{gibibytes(needed)}, but {where} has {gibibytes(free)} free; choose a lower resolution"
            )
