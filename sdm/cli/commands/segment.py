"""`sdm segment`: labels and signed distance maps of images by a trained network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line


def segment(
    images: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="IMAGE [IMAGE ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    model: Annotated[
        tyro.conf.UseAppendAction[list[Path]],
        tyro.conf.arg(aliases=["-m"], metavar="FILE", help_behavior_hint="(required; may be repeated)"),
    ],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    stride: Annotated[
        tuple[int, int, int] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="(default: half a window)")
    ] = None,
    all_parts: bool = False,
    mirrors: bool = False,
    device: Device = "auto",
) -> int | None:
    """Segment images by one or several networks of `sdm train segmentation`.

    Each image gives OUT/NAME.nii.gz, its label, and OUT/NAME_sdm.nii.gz, the exact signed distance map of that label in
    mm, negative inside. Both have the image's geometry. Where nothing, or everything, is foreground there is no such
    map, and the command says so.

    With --model given several times, for instance for trainings that differ in their --seed, the networks'
    probabilities are averaged before the label is cut, or their signed distances of one kind.

    Args:
        images: NIfTI or HDF5 files, or folders of them.
        model: A network: model.pt.
        out: Folder for the results; made if it is not there.
        stride: Voxels between the windows in which the network sees the image.
        all_parts: Keep every connected part, not only the largest.
        mirrors: Average over the mirror images of each training: eight times the work if there are those of all axes: a
            little more accurate.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from collections import Counter

    from sdm.cli.common.inputs import refuse_inputs
    from sdm.cli.common.progress import CountProgress
    from sdm.core.device import choose_device
    from sdm.errors import FormatError, SDMError
    from sdm.segmentation import check_ensemble, load_model, predict_ensemble, write_prediction
    from sdm.segmentation.data.checks import check_image
    from sdm.segmentation.data.folder import SPLIT_FOLDERS, read_images
    from sdm.segmentation.data.nifti_cases import nifti_files
    from sdm.segmentation.data.write_prediction import prediction_files

    if not model:
        raise SDMError("there is no network: name its model.pt with --model")
    where = choose_device(device)
    trained = [load_model(path, where) for path in model]
    check_ensemble(trained, model)
    for path, one in zip(model, trained, strict=True):
        if mirrors and not one.settings.mirrored:
            raise SDMError(f"{path} has seen no mirror images in its training: leave out --mirrors")
    cases = read_images(images)
    for case in cases:
        for one in trained:
            check_image(case, one.spacing)
    targets = [path for case in cases for path in prediction_files(case, out)]
    twice = next((path for path, count in Counter(targets).items() if count > 1), None)
    if twice is not None:
        raise FormatError(f"{twice} would be one image's label and another's distance map: segment them apart")
    # nnU-Net has the true labels in a folder beside that of the images, under the names of those to write.
    beside = {case.source.absolute().parent.parent / masks for case in cases for _, _, masks in SPLIT_FOLDERS.values()}
    truths = [path for folder in beside for path in nifti_files(folder)]
    refuse_inputs(targets, [*(case.source for case in cases), *truths, *model])
    out.mkdir(parents=True, exist_ok=True)
    empty = []
    with CountProgress("images") as progress:
        for number, case in enumerate(cases):
            progress(number, len(cases))
            found = predict_ensemble(trained, case.image, stride=stride, largest=not all_parts, mirrors=mirrors)
            label, distances = write_prediction(case, found.label, out)
            print_line(label if distances is None else f"{label} {distances}")
            if distances is None:
                empty.append(case.name)
    if empty:
        print_line(f"no distance map for {', '.join(empty)}: nothing, or everything, is foreground")
    return None
