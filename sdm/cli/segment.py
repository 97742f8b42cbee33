"""`sdm segment`: labels and signed distance maps of images by a trained network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def segment(
    images: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="IMAGE [IMAGE ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    model: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    stride: Annotated[
        tuple[int, int, int] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="(default: half a window)")
    ] = None,
    all_parts: bool = False,
    mirrors: bool = False,
    device: str = "auto",
) -> int | None:
    """Segment images by a network of `sdm train segmentation`.

    Each image gives OUT/NAME.nii.gz, its label, and OUT/NAME_sdm.nii.gz, the exact signed distance map of that label in
    mm, negative inside. Both have the image's geometry.

    Args:
        images: NIfTI or HDF5 files, or folders of them.
        model: The network: model.pt.
        out: Folder for the results; made if it is not there.
        stride: Voxels between the windows in which the network sees the image.
        all_parts: Keep every connected part, not only the largest.
        mirrors: Average over the mirror images of the training, eight times the work if there are those of all axes: a
            little more accurate.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.meter import Meter
    from sdm.device import choose_device
    from sdm.errors import SDMError
    from sdm.grid import Grid
    from sdm.segmentation import load_model, predict, write_prediction
    from sdm.segmentation.checks import check_spacing
    from sdm.segmentation.folder import read_images

    trained = load_model(model, choose_device(device))
    if mirrors and not trained.settings.mirrors:
        raise SDMError(f"{model} has seen no mirror images in its training: leave out --mirrors")
    cases = read_images(images)
    for case in cases:
        check_spacing(case, trained.spacing)
        Grid.from_affine(case.affine, case.image.shape)
    out.mkdir(parents=True, exist_ok=True)
    empty = []
    with Meter("images") as meter:
        for number, case in enumerate(cases):
            meter(number, len(cases))
            found = predict(
                trained.model,
                case.image,
                trained.settings.patch,
                stride=stride,
                largest=not all_parts,
                mirrors=trained.settings.mirrors if mirrors else "",
            )
            label, distances = write_prediction(case, found.label, out)
            print(label if distances is None else f"{label} {distances}", flush=True)
            if distances is None:
                empty.append(case.name)
    if empty:
        print(f"no distance map for {', '.join(empty)}: nothing, or everything, is foreground")
    return None
