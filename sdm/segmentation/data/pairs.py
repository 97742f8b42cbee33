"""Predicted labels with their true ones."""

from __future__ import annotations

import warnings
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.errors import FormatError, GridError, SDMWarning
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.folder import named, read_image
from sdm.segmentation.data.hdf5_cases import ENDINGS as HDF5
from sdm.segmentation.data.hdf5_cases import hdf5_files
from sdm.segmentation.data.labels import class_numbers, classes_of
from sdm.segmentation.data.nifti_cases import ENDINGS as NIFTI
from sdm.segmentation.data.nifti_cases import nifti_files

DISTANCES = "_sdm"
TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelPair:
    """A predicted label with its true one, on the host.

    Args:
        name: Of the prediction's file.
        prediction: (x,y,z) whole numbers, 0 for the background.
        truth: (x,y,z), likewise.
        classes: The numbers in the prediction, and those in the truth, but 0.
        spacing: Size of a voxel of the prediction along each axis in mm.
        files: Of prediction and truth.
    """

    name: str
    prediction: Tensor
    truth: Tensor
    classes: tuple[tuple[int, ...], tuple[int, ...]]
    spacing: tuple[float, float, float]
    files: tuple[Path, Path]


def label_pairs(predictions: Path, truths: Path, names: Container[str] | None = None) -> Iterator[LabelPair]:
    """Predicted labels of a file or folder with their true ones, by name.

    Args:
        predictions: A label, or a folder of them.
        truths: Likewise.
        names: Those to read; all if not given.

    Raises:
        FormatError: A prediction has no truth, or one of another shape or place, or is no label of whole numbers.
        GridError: The axes of a label are not orthogonal.
    """
    found = labels_of(predictions)
    found = {name: path for name, path in found.items() if not name.endswith(DISTANCES)}
    if not found:
        raise FormatError(f"{predictions} holds no labels to evaluate")
    known = labels_of(truths)
    if truths.is_file() and predictions.is_file():
        known = dict.fromkeys(found, truths)
    missing = [name for name in found if name not in known]
    if missing:
        raise FormatError(f"{truths} has no label for {', '.join(missing[:5])}")
    for name, path in found.items():
        if names is not None and name not in names:
            continue
        prediction, truth = read_image(path, classes=True), read_image(known[name], classes=True)
        first, second = numbers_of(prediction), numbers_of(truth)
        if first.shape != second.shape:
            raise FormatError(f"{path} has the shape {tuple(first.shape)}, but {known[name]} {tuple(second.shape)}")
        # HDF5 need not tell where it lies.
        told = known[name].name.endswith(NIFTI)
        if told and not np.allclose(prediction.affine, truth.affine, atol=TOLERANCE * max(prediction.spacing)):
            raise FormatError(f"{path} and {known[name]} lie at different places in space: resample one onto the other")
        yield LabelPair(
            name=name,
            prediction=first,
            truth=second,
            classes=(classes_of(first, path), classes_of(second, known[name])),
            spacing=prediction.spacing,
            files=(path, known[name]),
        )


def labels_of(place: Path) -> dict[str, Path]:
    """A label's file, or those of a folder, by name; see `named`.

    Raises:
        FormatError: Nothing is there.
    """
    if not place.exists():
        raise FormatError(f"there is no file or folder {place}")
    return named([place] if place.is_file() else nifti_files(place) or hdf5_files(place))


def numbers_of(case: Case) -> Tensor:
    """The label (x,y,z) of a file that was read as an image with classes: whole numbers, 0 for the background.

    Raises:
        FormatError: It is no label of whole numbers.
        GridError: Its axes are not orthogonal.
    """
    try:
        Grid.from_affine(case.affine, case.image.shape)
    except GridError as error:
        raise GridError(f"{case.source} cannot be evaluated: {error}") from None
    if case.source.suffix.lower() in HDF5 and case.label is not None:
        return case.label
    return torch.from_numpy(class_numbers(case.image.numpy(), case.source))


def mask_of(case: Case) -> Tensor:
    """The foreground (x,y,z) bool of a file that was read as an image with classes.

    Raises:
        FormatError: It is no label of whole numbers, or one of too many.
        GridError: Its axes are not orthogonal.

    Warns:
        SDMWarning: It has several classes, all of which count.
    """
    label = numbers_of(case)
    warn_of_classes(classes_of(label, case.source), case.source)
    return label != 0


def warn_of_classes(classes: tuple[int, ...], path: Path) -> None:
    """Say of a label with several classes that all count.

    Warns:
        SDMWarning: There are several.
    """
    if len(classes) > 1:
        warnings.warn(
            f"{path} has several classes, {classes[0]} to {classes[-1]}, and all count as foreground", SDMWarning,
            stacklevel=2,
        )  # fmt: skip
