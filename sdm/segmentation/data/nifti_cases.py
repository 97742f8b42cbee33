"""Cases in NIfTI: an image, and its label in another file of the same geometry."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import torch
from nibabel.filebasedimages import ImageFileError
from nibabel.spatialimages import HeaderDataError
from numpy.typing import NDArray

from sdm.errors import FormatError, one_line
from sdm.io.files.list_files import visible
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.gzip_check import held
from sdm.io.maps.nifti import opened
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.labels import foreground

ENDINGS = (".nii.gz", ".nii")
# A label may have been written by another program, which rounds the header its own way.
TOLERANCE = 1e-3
# Millimetres of the header's units of length that are not millimetres: metres and micrometres.
MILLIMETRES = {1: 1e3, 3: 1e-3}


def nifti_files(folder: Path) -> list[Path]:
    """The folder's NIfTI files, by name; no hidden ones."""
    return [p for p in visible(folder) if p.name.endswith(ENDINGS)] if folder.is_dir() else []


def stem_of(path: Path) -> str:
    """The file's name without `.nii` or `.nii.gz`."""
    return path.name.removesuffix(".gz").removesuffix(".nii")


def read_nifti(path: Path, label: Path | None = None, name: str | None = None) -> Case:
    """One case; its affine is in mm, whatever unit the header has.

    Raises:
        FormatError: A file cannot be read, is not of three dimensions, holds no plain numbers, or lies elsewhere than
            its label; or the label has values that are not whole numbers.
    """
    image, affine, space = _volume(path)
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    mask = None
    if label is not None:
        mask, other, _ = _volume(label)
        size = np.linalg.norm(other[:3, :3], axis=0)
        if not np.allclose(size, spacing, rtol=TOLERANCE):
            raise FormatError(f"{label} has voxels of {_lengths(size)} mm, but its image of {_lengths(spacing)} mm")
        if mask.shape == image.shape and not np.allclose(other, affine, atol=TOLERANCE * max(1.0, spacing.max())):
            raise FormatError(f"{label} lies elsewhere in space than its image {path.name}: resample it onto the image")
    return Case(
        name=name or stem_of(path),
        image=torch.from_numpy(image),
        label=None if mask is None or label is None else torch.from_numpy(foreground(mask, label)),
        spacing=(float(spacing[0]), float(spacing[1]), float(spacing[2])),
        affine=affine,
        source=path,
        space=space,
    )


def _volume(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float64], int]:
    """Values, affine in mm, and the number of its space."""
    try:
        with held(path) as holder:
            image = opened(path, holder, with_lengths=True)
            shape = tuple(image.shape)
            if len(shape) < 3 or any(n != 1 for n in shape[3:]):
                raise FormatError(f"{path} has the shape {shape}: an image of three dimensions is needed")
            values = plain_numbers(np.asanyarray(image.dataobj).reshape(shape[:3]), path)
    except (OSError, EOFError, ImageFileError, HeaderDataError, ValueError, zlib.error) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{path} cannot be read as NIfTI: {one_line(error)}") from error
    affine = np.array(image.affine, dtype=np.float64)
    if not (np.isfinite(affine).all() and (np.linalg.norm(affine[:3, :3], axis=0) > 0).all()):
        raise FormatError(f"{path} has no usable voxel size in its header")
    affine[:3] *= MILLIMETRES.get(int(image.header["xyzt_units"]) & 7, 1.0)
    return values, affine, int(image.header["sform_code"]) or int(image.header["qform_code"])


def _lengths(sizes: np.ndarray) -> str:
    return " x ".join(f"{s:.4g}" for s in sizes)
