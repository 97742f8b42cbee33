"""Label volumes to files of distance maps, one for each class."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.common.one_after_other import one_after_other
from sdm.cli.common.output_files import VOLUMES, plan
from sdm.cli.common.printed_line import counted, print_line
from sdm.cli.common.progress import FileProgress
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import SDMError
from sdm.io import check_target, load, save
from sdm.io.files.stand_in import shown
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


@dataclass(frozen=True, kw_only=True)
class LabelMaps:
    """Options of the maps of label volumes.

    Args:
        classes: Their values; all that are there but 0 if not given.
        surface: As for `sdm.euclidean_distance_transform`.
        signed: As there.
        smooth: Standard deviation of a Gaussian, for maps of smooth surfaces; None for voxels.
        device: Where to compute.

    Raises:
        SDMError: Options that contradict each other.
    """

    classes: list[int] | None = None
    surface: str = "faces"
    signed: bool = True
    smooth: float | None = None
    device: torch.device

    def __post_init__(self) -> None:
        if self.smooth is not None and not self.signed:
            raise SDMError("--smooth gives signed maps of a surface: leave out --unsigned")
        if self.smooth is not None and self.surface != "faces":
            raise SDMError("--smooth measures to a surface of its own: leave out --surface")


def write_maps_of_volumes(volumes: list[Path], out: Path, options: LabelMaps, ending: str | None = None) -> int | None:
    """Write the maps of label volumes, one volume after the other; the exit code, 2 if some failed.

    Args:
        volumes: Files, and folders of them.
        out: A file for one volume, or a folder, in which every map has its class in its name, so that no two are alike.
        options: What is measured.
        ending: The format that was requested for maps in a folder.

    Raises:
        SDMError: As by `write_label_maps` of a volume that is the only one.
        FormatError: Likewise, or outputs that cannot be planned (see `plan`), or a full disk.
    """
    jobs = plan(volumes, out, ending, kind=VOLUMES)
    if jobs[0][1] == out:
        write_label_maps(jobs[0][0], out, options)
        return None
    place = os.path.realpath(out)
    # What is written can only be one of these.
    near = [source for source, _ in jobs if os.path.realpath(source).startswith(f"{place}{os.sep}")]

    def write(source: Path, target: Path, _: FileProgress) -> None:
        write_label_maps(source, target, options, always_named=True, inputs=near)

    return one_after_other(jobs, "maps", write, VOLUMES.one, VOLUMES.many)


def write_label_maps(
    source: Path, out: Path, options: LabelMaps, *, always_named: bool = False, inputs: Sequence[Path] = ()
) -> None:
    """Write a map for each class of a label volume, and say so, a line each.

    Args:
        source: The volume.
        out: The file of a single class, after which those of several are named.
        options: What is measured.
        always_named: Whether a single class is in its file's name, too.
        inputs: Other files that are not to be written over.

    Raises:
        SDMError: Values that are no labels, or none to measure.
        FormatError: A file that cannot be read or written.
    """
    check_target(out)
    field = load(source)
    if not isinstance(field, SDM):
        raise SDMError(f"{source} holds a narrow band, so it is no label volume: give one of labels")
    labels = labels_of(field, source)
    values = classes_of(labels, options.classes, source)
    targets = [out] if len(values) == 1 and not always_named else [_named(out, value) for value in values]
    refuse_inputs(targets, [source, *inputs])
    for target in targets:
        check_target(target)
    where = labels.to(options.device)
    for value, target in zip(values, targets, strict=True):
        begin = time.perf_counter()
        mask = where == value
        save(class_map(mask, value, field.grid, source, options), target)
        print_line(
            f"{source.name}: class {value}, {counted(int(mask.sum()), 'voxel')}, {field.grid.summary}, "
            f"{time.perf_counter() - begin:.2f} s on {options.device}, written to {shown(target)}"
        )


def class_map(mask: torch.Tensor, value: int, grid: Grid, source: Path, options: LabelMaps) -> SDM:
    """The distance map of a class of the volume `source`, on the device of its mask (nx,ny,nz).

    Raises:
        SDMError: The class fills the volume, or a smoothing that leaves nothing of it.
    """
    if options.smooth is not None:
        # Its package imports what all else here needs none of.
        from sdm.deepsdf.samples.label_surface import label_map

        return label_map(mask, grid, smoothing=options.smooth)
    if options.signed and bool(mask.all()):
        raise SDMError(f"every voxel of {source} is of class {value}, so that it has no surface to measure from")
    found = euclidean_distance_transform(mask, grid.spacing, signed=options.signed, surface=options.surface)
    return SDM(found, grid, sign=None if options.signed else "none")


def around_class(mask: torch.Tensor, grid: Grid, reach: float) -> tuple[torch.Tensor, Grid]:
    """The part of a class's mask (nx,ny,nz) and of its grid with the class and what is nearer to it than `reach`.

    It has a voxel more on each side, if the grid does, so that distances near the class are those of the whole volume.

    Args:
        mask: On any device; not empty.
        grid: That of the mask.
        reach: A length, in the grid's unit.
    """
    rows = mask.any(2)
    part = []
    for along, size, step in zip((rows.any(1), rows.any(0), mask.any(0).any(0)), grid.shape, grid.spacing, strict=True):
        places, more = along.nonzero(), int(np.ceil(reach / step)) + 1
        part.append(slice(max(0, int(places[0]) - more), min(size, int(places[-1]) + 1 + more)))
    origin = grid.affine @ [*(along.start for along in part), 1]
    found = mask[tuple(part)]
    return found, Grid(origin[:3], grid.spacing, found.shape, grid.direction)


def looks_like_labels(values: torch.Tensor) -> bool:
    """True if values are whole numbers and none is below 0."""
    return bool((values >= 0).all()) and bool((values == values.round()).all())


def labels_of(field: SDM, source: Path) -> torch.Tensor:
    """The labels (nx,ny,nz) int32 of a volume.

    Raises:
        SDMError: Its values are no whole numbers.
    """
    values = field.values
    if not bool((values == values.round()).all()) or float(values.abs().max()) > LARGEST:
        raise SDMError(f"{source} holds other values than whole numbers, so it is no label volume: give one of labels")
    return values.int()


def classes_of(labels: torch.Tensor, classes: list[int] | None, source: Path) -> list[int]:
    """Those of the wanted classes, each once, or all of labels on the host but 0.

    Raises:
        SDMError: A class that is not there, or none at all.
    """
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
