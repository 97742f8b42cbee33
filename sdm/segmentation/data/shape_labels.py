"""Labels without images: shapes of an organ, for synthetic cases."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from sdm.errors import FormatError, SDMError
from sdm.segmentation.data.checks import same_spacing, voxel
from sdm.segmentation.data.folder import read_image
from sdm.segmentation.data.pairs import labels_of, mask_of


def read_shapes(folder: Path, spacing: Sequence[float]) -> list[Tensor]:
    """Labels (x,y,z) bool of a folder, by name: NIfTI files, or HDF5 files with `label`.

    Args:
        folder: It, or one file.
        spacing: The voxel size in mm that all must have, within 5 percent.

    Raises:
        FormatError: There are none, or one cannot be read.
        SDMError: One is empty or full, or has voxels of another size.
    """
    if not folder.exists():
        raise FormatError(f"{folder} is not there")
    found = []
    for name, path in labels_of(folder).items():
        case = read_image(path, classes=True)
        label = mask_of(case)
        if not same_spacing(case.spacing, spacing):
            raise SDMError(f"{path} has voxels of {voxel(case.spacing)} mm, the cases of {voxel(spacing)}: resample it")
        if not bool(label.any()) or bool(label.all()):
            raise SDMError(f"{name} in {folder} has no foreground or no background, so it is no shape")
        found.append(label)
    if not found:
        raise FormatError(f"{folder} holds no labels: NIfTI files, or HDF5 files with a data set label, are needed")
    return found
