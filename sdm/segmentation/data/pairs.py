"""Predicted labels with their true ones."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
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
from sdm.segmentation.data.labels import foreground
from sdm.segmentation.data.nifti_cases import ENDINGS as NIFTI
from sdm.segmentation.data.nifti_cases import nifti_files

DISTANCES = "_sdm"
TOLERANCE = 1e-3


def label_pairs(predictions: Path, truths: Path) -> Iterator[tuple[str, Tensor, Tensor, tuple[float, float, float]]]:
    """Name, predicted label, true label (x,y,z) bool, and the voxel size in mm of the prediction.

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
        prediction, truth = read_image(path), read_image(known[name])
        first, second = mask_of(prediction), mask_of(truth)
        if first.shape != second.shape:
            raise FormatError(f"{path} has the shape {tuple(first.shape)}, but {known[name]} {tuple(second.shape)}")
        # HDF5 need not tell where it lies.
        told = known[name].name.endswith(NIFTI)
        if told and not np.allclose(prediction.affine, truth.affine, atol=TOLERANCE * max(prediction.spacing)):
            raise FormatError(f"{path} and {known[name]} lie at different places in space: resample one onto the other")
        yield name, first, second, prediction.spacing


def labels_of(place: Path) -> dict[str, Path]:
    """A label's file, or those of a folder, by name; see `named`.

    Raises:
        FormatError: Nothing is there.
    """
    if not place.exists():
        raise FormatError(f"there is no file or folder {place}")
    return named([place] if place.is_file() else nifti_files(place) or hdf5_files(place))


def mask_of(case: Case) -> Tensor:
    """The foreground (x,y,z) bool of a file that was read as an image.

    Raises:
        FormatError: It is no label of whole numbers.
        GridError: Its axes are not orthogonal.

    Warns:
        SDMWarning: It has several classes, all of which count.
    """
    try:
        Grid.from_affine(case.affine, case.image.shape)
    except GridError as error:
        raise GridError(f"{case.source} cannot be evaluated: {error}") from None
    if case.source.suffix.lower() in HDF5 and case.label is not None:
        return case.label
    values = case.image.numpy()
    mask = foreground(values, case.source)
    found = values[mask]
    if found.size and (least := np.round(found.min())) != (most := np.round(found.max())):
        warnings.warn(
            f"{case.source} has several classes, {least:g} to {most:g}, and all count as foreground", SDMWarning,
            stacklevel=2,
        )  # fmt: skip
    return torch.from_numpy(mask)
