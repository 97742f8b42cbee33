"""`sdm train segmentation`: a network for one organ, guided by its distance map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line

if TYPE_CHECKING:
    import torch

    from sdm.segmentation import Case, SegmentationModel, Settings
    from sdm.segmentation.train.training import Source


def segmentation(
    *,
    data: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    method: Annotated[str, tyro.conf.arg(metavar="METHOD")] = "baseline",
    network: Literal["vnet", "unet"] = "vnet",
    patch: tuple[int, int, int] = (112, 112, 80),
    coarsen: int = 1,
    batch_size: int = 4,
    steps: int = 2000,
    optimizer: Literal["adam", "sgd"] = "adam",
    learning_rate: float = 1e-3,
    schedule: Literal["cosine", "constant"] = "cosine",
    average: float = 0.0,
    augment: Literal["none", "published", "affine", "strong", "scanner"] = "affine",
    mirrors: Annotated[str, tyro.conf.arg(metavar="AXES")] = "xyz",
    targets: Literal["case", "patch"] = "case",
    filters: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(as published)")] = None,
    dropout: Annotated[float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(as published)")] = None,
    last_dropout: float = 0.0,
    position: bool = False,
    labels: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: none)")] = None,
    synthetic: float = 0.5,
    spacing: Annotated[
        tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="(default: as most cases)")
    ] = None,
    seed: int = 0,
    budget_s: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None,
    device: Device = "auto",
    compile: bool = False,  # noqa: A002
    bfloat16: bool = False,
    resume: bool = False,
) -> int | None:
    """Train a network that segments one organ, by one of the methods of Ma et al. and Juhl et al. (MIDL 2020, 2019).

    DATA holds HDF5 files with the data sets image and label, or NIfTI files as in nnU-Net: imagesTr/NAME_0000.nii.gz
    and labelsTr/NAME.nii.gz. The network, OUT/model.pt, is for sdm segment. If DATA has cases to validate on (val, or
    imagesTs and labelsTs) their scores are printed. A training that is cut short goes on with --resume.

    Args:
        data: Folder of the cases. Bad ones are named before anything is trained.
        out: Folder for the network; made if it is not there.
        method: baseline, boundary, hausdorff, sdf-product, pwr (regression of the signed distance), or an auxiliary
            output: head or branch, dtm or sdf, l1, l2 or l1l2, as in head-sdf-l1; also pwc, hausdorff-foreground.
        network: vnet or unet (3D).
        patch: Voxels of a patch along each axis, multiples of 16 (vnet) or 8 (unet).
        coarsen: Downsample the input by this factor: a patch of as many voxels holds more of the body, or all of it.
            Labels and distances are still those of the image's voxels.
        batch_size: Patches of a step.
        steps: Steps of the optimiser.
        optimizer: adam or sgd.
        learning_rate: The highest learning rate, to which it rises in a moment.
        schedule: It falls to zero along a cosine, or stays constant.
        average: Share of the training, up to its end, over which the weights are averaged; 0: the last ones.
        augment: Random changes of patches: none; quarter turns and mirror images as published; affine; strong, which
            also changes contrast, shading and sharpness; scanner, affine with these and noise.
        mirrors: Axes along which patches are mirrored at random: xyz, any of them, or "".
        targets: Distance maps of whole cases, or of each patch by itself, as in Ma's public code.
        filters: Channels of the finest level.
        dropout: Probability with which channels of the coarsest level are dropped.
        last_dropout: The same of the last level; 0.5 in Ma's public code.
        position: Tell the network where each voxel is in its volume. For volumes that show the same part of the body.
        labels: Labels of cases without images (NIfTI, or HDF5 with label; voxels of the same size). Images of DATA are
            then warped to them, on the device, anew for each patch.
        synthetic: Share of the patches that are of such synthetic cases.
        spacing: Voxel size in mm that every case must have, within 5 percent.
        seed: Whole number that everything random depends on.
        budget_s: Seconds of training at most; what is unfinished then goes on with --resume.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
        compile: Compile the network first, for long trainings on GPUs.
        bfloat16: On a CPU too, where it has it: twice the steps in the same time. A GPU trains so in any case.
        resume: Go on from OUT/checkpoint.pt if it is there. Without it an unfinished training is never replaced.
    """
    import time

    from sdm.cli.common.progress import CountProgress
    from sdm.core.device import choose_device
    from sdm.io.maps.formats import check_file
    from sdm.segmentation import Settings, TrainedModel, save_model, train
    from sdm.training.budget import check_budget
    from sdm.training.checkpoints import refuse_unfinished, training_folder

    settings = Settings(
        method=method,
        architecture=network,
        patch=patch,
        coarsen=coarsen,
        batch=batch_size,
        steps=steps,
        optimizer=optimizer,
        learning_rate=learning_rate,
        schedule=schedule,
        average=average,
        augment=augment,
        mirrors=mirrors,
        targets=targets,
        filters=filters,
        dropout=dropout,
        last_dropout=last_dropout,
        position=position,
        synthetic=0.0 if labels is None else synthetic,
        seed=seed,
    )
    # None at all is allowed: it shows that the cases can be read.
    if budget_s:
        check_budget(budget_s)
    checkpoint = out / "checkpoint.pt"

    if not resume:
        refuse_unfinished(checkpoint)
    where = choose_device(device)
    cases, others = _cases(data, spacing)
    patches = _patches(cases, labels, settings, where)
    deadline = None if budget_s is None else time.monotonic() + budget_s
    with training_folder(out):
        check_file(out / "model.pt")
        # Another process may have left one while the cases were read.
        if not resume:
            refuse_unfinished(checkpoint)
        with CountProgress("steps") as progress:
            training = train(
                patches,
                settings,
                checkpoint=checkpoint,
                deadline=deadline,
                compiled=compile,
                bfloat16=bfloat16 or None,
                progress=progress,
            )
        if training.step < steps:
            print_line(f"{checkpoint}: {training.step:,} of {steps:,} steps are done; go on with --resume")
            return None
        save_model(TrainedModel(training.model, settings, cases[0].spacing), out / "model.pt")
        checkpoint.unlink(missing_ok=True)
    print_line(f"{out / 'model.pt'}: {method}, {steps:,} steps on {len(cases)} cases, {training.seconds:,.0f} s")
    if others:
        _print_scores(method, training.model, others, patch)
    return None


def _cases(data: Path, spacing: tuple[float, float, float] | None) -> tuple[list[Case], list[Case]]:
    """The cases to train with, and those to validate with that have a label."""
    from sdm.segmentation import check_cases, has_part, read_cases

    cases = read_cases(data, "train")
    check_cases(cases, spacing=spacing)
    others = read_cases(data, "val", labels=False) if has_part(data, "val") else []
    others = [case for case in others if case.label is not None]
    if others:
        check_cases(others, spacing=cases[0].spacing)
    return cases, others


def _patches(cases: list[Case], labels: Path | None, settings: Settings, device: torch.device) -> Source:
    """Patches of the cases, and with a folder of label maps also of cases made up from these."""
    from sdm.segmentation import Patches, SyntheticPatches, read_shapes

    if labels is None:
        return Patches.of_settings(cases, settings, device)
    found = read_shapes(labels, cases[0].spacing)
    return SyntheticPatches.of_settings_and_shapes(cases, settings, device, found)


def _print_scores(method: str, model: SegmentationModel, cases: list[Case], patch: tuple[int, int, int]) -> None:
    from sdm.segmentation import table, validate

    scores = [largest for _, _, largest in validate(model, cases, patch)]
    columns = ("dice", "jaccard", "hausdorff95_mm", "average_surface_distance_mm")
    print(f"largest component of {len(cases)} cases, mean (standard deviation):")
    print(table({method: scores}, columns))
