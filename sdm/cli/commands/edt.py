"""`sdm edt`: label volumes to signed distance maps, one for each class."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device, Ending
from sdm.cli.common.numbers import numbers


def edt(
    labels: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="LABELS [LABELS ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    classes: Annotated[
        tuple[int, ...] | None, numbers(int, "N [N ...]"), tyro.conf.arg(help_behavior_hint="(default: all but 0)")
    ] = None,
    surface: Literal["faces", "centres"] = "faces",
    unsigned: bool = False,
    smooth: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: voxels as they are)")
    ] = None,
    format: Annotated[  # noqa: A002
        Ending | None, tyro.conf.arg(help_behavior_hint="(default: as OUT ends, or nii.gz)")
    ] = None,
    device: Device = "auto",
) -> int | None:
    """Compute the exact signed distance map of each class of label volumes: negative inside, in the image's unit.

    A volume of one class gives one file. Of several each is written to a file with its value in the name: OUT
    organs.nii.gz gives organs_1.nii.gz, organs_2.nii.gz, ... Several volumes, or a folder of them, give a folder of
    maps, in which they lie as in the folder that was named, all with their class in the name. A bad volume is reported
    at the end, the others are computed, and the exit code is 2.

    Args:
        labels: Volumes of whole numbers: NIfTI, NRRD, or other maps; or folders of them, nested as deep as they are.
        out: File to write (its ending is the format: .nii.gz, .nii, .npz, .nrrd, .mha, .mhd, .vti, .zarr, .nvdb), or a
            folder.
        classes: Values to measure.
        surface: The surface of a class is made of its voxels' faces; or, with centres, distances end at the centre of
            the nearest voxel on the other side, as SciPy's do.
        unsigned: Distances from the class alone, 0 inside.
        smooth: Measure exactly to a smooth surface of the same volume in place of voxels: the standard deviation of the
            Gaussian that takes away their steps, in the image's unit.
        format: File format, for maps written to a folder.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.label_maps import LabelMaps, write_maps_of_volumes
    from sdm.core.device import choose_device

    options = LabelMaps(
        classes=None if classes is None else list(classes),
        surface=surface,
        signed=not unsigned,
        smooth=smooth,
        device=choose_device(device),
    )
    return write_maps_of_volumes(labels, out, options, format)
