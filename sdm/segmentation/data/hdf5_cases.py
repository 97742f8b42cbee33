"""Cases in HDF5: one file each, data sets `image` and `label`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from sdm.core.device import require_memory
from sdm.errors import FormatError, SDMError, one_line
from sdm.io.files.list_files import visible
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.labels import class_numbers, foreground

if TYPE_CHECKING:
    import h5py

ENDINGS = (".h5", ".hdf5")


def hdf5_files(folder: Path) -> list[Path]:
    """The folder's HDF5 files, by name; no hidden ones."""
    return [p for p in visible(folder) if p.suffix.lower() in ENDINGS] if folder.is_dir() else []


def read_hdf5(path: Path, *, classes: bool = False) -> Case:
    """One case: `image` (x,y,z) of any number type, `label` (x,y,z) if there is one.

    The left-atrium data of Yu et al. (UA-MT) has this layout and does not tell the size of a voxel; an attribute
    `spacing` of the file, three lengths in mm, does. With `classes` the label keeps its whole numbers, and is no mask.

    Raises:
        FormatError: The file cannot be read, has no `image`, or something there is not of numbers or lies in another
            file.
    """
    try:
        import h5py
    except ImportError:
        raise FormatError(f"{path} needs h5py: pip install '.[segmentation]' in a clone") from None
    try:
        with h5py.File(path, "r") as file:
            if "image" not in file:
                raise FormatError(f"{path} has no data set called image: found {', '.join(file) or 'nothing'}")
            image = _values(file, "image", path)
            label = _values(file, "label", path) if "label" in file else None
            told = file.attrs.get("spacing", (1.0, 1.0, 1.0))
    # Data sets of other software may be groups, or of types that numpy does not know.
    except (OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
        if isinstance(error, SDMError):
            raise
        raise FormatError(f"{path} cannot be read: {one_line(error)}") from error
    if image.dtype.kind not in "buif":
        raise FormatError(f"{path} has an image of type {image.dtype}: numbers are needed")
    try:
        spacing = np.asarray(told, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise FormatError(f"{path} has the spacing {one_line(told)!r}: three lengths in mm are needed") from None
    if spacing.shape != (3,):
        raise FormatError(f"{path} has a spacing of {len(spacing)} numbers: three lengths in mm are needed")
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise FormatError(f"{path} has the spacing {one_line(told)}: three positive lengths in mm are needed")
    return Case(
        name=path.stem,
        image=torch.from_numpy(image.astype(np.float32)),
        label=None if label is None else torch.from_numpy((class_numbers if classes else foreground)(label, path)),
        spacing=(float(spacing[0]), float(spacing[1]), float(spacing[2])),
        affine=np.diag([*spacing, 1.0]),
        source=path,
    )


def _values(file: h5py.File, name: str, path: Path) -> np.ndarray:
    """A data set of the file itself: a link or storage elsewhere could name any file that the user may read."""
    import h5py

    found = file[name]
    stored = found if isinstance(found, h5py.Dataset) else None
    if found.file.filename != file.filename or (stored is not None and (stored.external or stored.is_virtual)):
        raise FormatError(f"{path} has its {name} in another file, which is not read: copy it into this one")
    if stored is not None:
        require_memory(stored.nbytes, torch.device("cpu"), f"the {name} of {path}")
    return np.asarray(found)
