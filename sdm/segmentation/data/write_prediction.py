"""A prediction as NIfTI, with the geometry of its image."""

from __future__ import annotations

import gzip
from pathlib import Path

import nibabel as nib
import numpy as np
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.io.files.atomic import replacing
from sdm.io.maps.nifti import write_compressed
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.nifti_cases import ENDINGS
from sdm.segmentation.infer.predict import label_distance_map


def prediction_files(case: Case, folder: Path) -> tuple[Path, Path]:
    """Files that `write_prediction` writes: the label and its distance map."""
    return folder / f"{case.name}{ENDINGS[0]}", folder / f"{case.name}_sdm{ENDINGS[0]}"


def write_prediction(case: Case, label: Tensor, folder: Path) -> tuple[Path, Path | None]:
    """Write `NAME.nii.gz` (uint8, 1 inside) and `NAME_sdm.nii.gz` (float32, mm, negative inside, 0 on voxel faces).

    Both have the image's affine, and say of it what the image does: where its header has none, programs guess one, each
    in its own way, and have to guess the same. A label that is empty or full has no distance map: then there is no
    second file, and one that is there is removed.

    Returns:
        The two files, None for one that was not written.

    Raises:
        GridError: The affine is sheared, so that distances along the axes are not those in space.
        FormatError: The folder cannot be written.
    """
    grid = Grid.from_affine(case.affine, label.shape)
    target, distances = prediction_files(case, folder)
    image = nib.Nifti1Image(label.cpu().numpy().astype(np.uint8), case.affine)
    image.header.set_xyzt_units("mm", "unknown")
    image.set_sform(case.affine, case.space)
    image.set_qform(case.affine, case.space)
    with replacing(target) as part:
        part.write_bytes(gzip.compress(image.to_bytes(), compresslevel=6, mtime=0))
    if not label.any() or label.all():
        # One of an earlier label would be taken for this one's.
        distances.unlink(missing_ok=True)
        return target, None
    field = SDM(label_distance_map(label, grid.spacing).cpu(), grid, 0)
    with replacing(distances) as part:
        write_compressed(field, part, space=case.space)
    return target, distances
