"""Label volumes to files of distance maps, one for each class."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch

from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.common.printed_line import counted, print_line
from sdm.core.signed_distance_map import SDM
from sdm.deepsdf.samples.label_surface import label_map
from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import SDMError
from sdm.io import check_target, load, save
from sdm.io.maps.formats import FORMATS

# Whole numbers of float32, as which images are read.
LARGEST = 1 << 24


def refuse_mesh_options(source: Path, options: list[str]) -> None:
    """Refuse options that say something of meshes alone, for a label volume.

    Raises:
        SDMError: There are such options.
    """
    if options:
        raise SDMError(
            f"{source} is a label volume, whose maps are its classes' distance transforms: {options[0]} is for meshes"
        )


def write_label_maps(
    source: Path,
    out: Path,
    *,
    classes: list[int] | None = None,
    surface: str = "faces",
    signed: bool = True,
    smooth: float | None = None,
    device: torch.device,
) -> None:
    """Write a map for each class of a label volume, and say so, a line each.

    Args:
        source: The volume.
        out: The file of a single class, after which those of several are named.
        classes: Their values; all that are there but 0 if not given.
        surface: As for `sdm.euclidean_distance_transform`.
        signed: As there.
        smooth: Standard deviation of a Gaussian, for maps of smooth surfaces; None for voxels.
        device: Where to compute.

    Raises:
        SDMError: Values that are no labels, none to measure, or options that contradict each other.
        FormatError: A file that cannot be read or written.
    """
    if smooth is not None and not signed:
        raise SDMError("--smooth gives signed maps of a surface: leave out --unsigned")
    if smooth is not None and surface != "faces":
        raise SDMError("--smooth measures to a surface of its own: leave out --surface")
    if source.is_dir() and source.suffix.lower() != ".zarr":
        raise SDMError(f"{source} is a folder; give one label volume")
    check_target(out)
    field = load(source)
    labels = _labels_of(field, source)
    values = _classes_of(labels, classes, source)
    targets = [out] if len(values) == 1 else [_named(out, value) for value in values]
    refuse_inputs(targets, [source])
    for target in targets:
        check_target(target)
    where = labels.to(device)
    for value, target in zip(values, targets, strict=True):
        begin = time.perf_counter()
        mask = where == value
        if signed and smooth is None and bool(mask.all()):
            raise SDMError(f"every voxel of {source} is of class {value}, so that it has no surface to measure from")
        if smooth is None:
            found = euclidean_distance_transform(mask, field.grid.spacing, signed=signed, surface=surface)
            made = SDM(found, field.grid, sign=None if signed else "none")
        else:
            made = label_map(mask, field.grid, smoothing=smooth)
        save(made, target)
        print_line(
            f"{source.name}: class {value}, {counted(int(mask.sum()), 'voxel')}, {field.grid.summary}, "
            f"{time.perf_counter() - begin:.2f} s on {device}, written to {target}"
        )


def _labels_of(field: SDM, source: Path) -> torch.Tensor:
    values = field.values
    if not bool((values == values.round()).all()) or float(values.abs().max()) > LARGEST:
        raise SDMError(f"{source} holds other values than whole numbers, so it is no label volume: give one of labels")
    return values.int()


def _classes_of(labels: torch.Tensor, classes: list[int] | None, source: Path) -> list[int]:
    there = [int(value) for value in np.unique(labels.numpy()) if value != 0]
    if classes is None:
        if not there:
            raise SDMError(f"{source} holds nothing but 0: there is no class to measure")
        return there
    missing = [value for value in classes if value not in there and not (value == 0 and bool((labels == 0).any()))]
    if missing:
        known = f"there are {', '.join(map(str, there))}" if there else "it holds nothing but 0"
        raise SDMError(f"{source} has no class {missing[0]}: {known}")
    return list(dict.fromkeys(classes))


def _named(out: Path, value: int) -> Path:
    ending = next(known for known in FORMATS if out.name.lower().endswith(f".{known}"))
    return out.with_name(f"{out.name[: -len(ending) - 1]}_{value}{out.name[-len(ending) - 1 :]}")
