"""A folder of cases, in one of the layouts that are known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sdm.core.given_values import as_path
from sdm.errors import FormatError
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.hdf5_cases import ENDINGS as HDF5
from sdm.segmentation.data.hdf5_cases import hdf5_files, read_hdf5
from sdm.segmentation.data.nifti_cases import ENDINGS, nifti_files, read_nifti, stem_of

LAYOUTS = "HDF5 files with image and label, or NIfTI files in imagesTr and labelsTr"
# nnU-Net numbers an image's channels; there is one here.
CHANNEL = "_0000"
# Sub-folder of HDF5 files, and nnU-Net's pair of folders, for each part of the data.
SPLIT_FOLDERS = {"train": ("train", "imagesTr", "labelsTr"), "val": ("val", "imagesTs", "labelsTs")}


def read_cases(folder: Path, part: str | None = None, *, labels: bool = True) -> list[Case]:
    """The cases of a folder, by name.

    Args:
        folder: HDF5 files (see `read_hdf5`), or nnU-Net's `imagesTr/NAME_0000.nii.gz` with `labelsTr/NAME.nii.gz`.
        part: "train" or "val": the sub-folder of that name, or `imagesTr`/`imagesTs` with their labels. If there are
            no such sub-folders, "train" is the folder itself. None: as "train", or NIfTI files in the folder itself.
        labels: Whether every image must have a label.

    Raises:
        FormatError: There are no cases, or one of them has no label or cannot be read; it is named.
    """
    folder = as_path(folder)
    if not folder.is_dir():
        raise FormatError(f"{folder} is not a folder of cases: give one with {LAYOUTS}")
    plain, images, masks = SPLIT_FOLDERS[part or "train"]
    for place in (folder / plain,) if part == "val" else (folder / plain, folder):
        if files := hdf5_files(place):
            cases = [read_hdf5(path) for path in files]
            return _with_labels(cases) if labels else cases
    if (folder / images).is_dir():
        return _pairs(folder / images, folder / masks, labels)
    if part is None and (files := nifti_files(folder)):
        return [read_nifti(path, name=stem_of(path).removesuffix(CHANNEL)) for path in files]
    if part is None:
        raise FormatError(f"{folder} holds no images: give the folder that NIfTI or HDF5 files are in")
    raise FormatError(f"{folder} holds no cases to {part}: give a folder with {LAYOUTS}")


def has_part(folder: Path, part: str) -> bool:
    """True if a folder has cases of a part of its own."""
    plain, images, _ = SPLIT_FOLDERS[part]
    return bool(hdf5_files(folder / plain) or nifti_files(folder / images))


def read_image(path: Path, *, classes: bool = False) -> Case:
    """One HDF5 or NIfTI file, without a label of its own if NIfTI; `classes` as for `read_hdf5`.

    Raises:
        FormatError: It is neither, or cannot be read.
    """
    if path.suffix.lower() in HDF5:
        return read_hdf5(path, classes=classes)
    if path.name.endswith(ENDINGS):
        return read_nifti(path, name=stem_of(path).removesuffix(CHANNEL))
    raise FormatError(f"{path} is neither NIfTI (.nii, .nii.gz) nor HDF5 (.h5)")


def read_images(places: Sequence[Path]) -> list[Case]:
    """The images of files and folders, in this order; names are told apart.

    Raises:
        FormatError: A file is not there or cannot be read, a folder holds none, or two have one name.
    """
    cases: list[Case] = []
    for place in places:
        if place.is_dir():
            cases += read_cases(place, labels=False)
        elif place.is_file():
            cases.append(read_image(place))
        else:
            raise FormatError(f"{place} is not there")
    names = [case.name for case in cases]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise FormatError(f"two images are called {min(twice)}, and so would be their labels: segment them apart")
    return cases


def named(files: Sequence[Path]) -> dict[str, Path]:
    """Files by their names without endings.

    Raises:
        FormatError: Two have one name, such as a .nii and a .nii.gz.
    """
    found: dict[str, Path] = {}
    for path in files:
        name = stem_of(path) if path.name.endswith(ENDINGS) else path.stem
        if name in found:
            raise FormatError(f"{found[name]} and {path.name} have one name: take one of them out")
        found[name] = path
    return found


def _pairs(images: Path, masks: Path, wanted: bool) -> list[Case]:
    labels = named(nifti_files(masks))
    cases = []
    for stem, path in named(nifti_files(images)).items():
        if not stem.endswith(CHANNEL):
            if stem[-5:-4] == "_" and stem[-4:].isdigit():
                raise FormatError(f"{path} is a second channel: images of one channel ({CHANNEL}) are supported")
            raise FormatError(f"{path} is not named as in nnU-Net: call it {stem}{CHANNEL}{ENDINGS[0]}")
        name = stem.removesuffix(CHANNEL)
        if name not in labels and wanted:
            raise FormatError(f"{path} has no label: {masks / (name + ENDINGS[0])} is not there")
        cases.append(read_nifti(path, labels.get(name), name))
    if not cases:
        raise FormatError(f"{images} holds no images: give a folder with {LAYOUTS}")
    return cases


def _with_labels(cases: list[Case]) -> list[Case]:
    for case in cases:
        if case.label is None:
            raise FormatError(f"{case.source} has no data set called label")
    return cases
