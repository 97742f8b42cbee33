"""Small cases of an ellipsoid in noise, on disk and in memory."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
import torch

from sdm.segmentation import Case

SHAPE = (26, 24, 20)
AFFINE = np.array([[-0.8, 0, 0, 10], [0, -0.8, 0, 20], [0, 0, 1.25, -5], [0, 0, 0, 1.0]])


def volume(seed: int, shape: tuple[int, int, int] = SHAPE) -> tuple[np.ndarray, np.ndarray]:
    """Image float32 and label uint8."""
    random = np.random.default_rng(seed)
    centre = np.array(shape) / 2 + random.uniform(-2, 2, 3)
    radius = random.uniform(5, 7, 3)
    label = (((np.indices(shape).transpose(1, 2, 3, 0) - centre) / radius) ** 2).sum(-1) < 1
    image = 3 * label + 0.3 * random.standard_normal(shape)
    return image.astype(np.float32), label.astype(np.uint8)


def case(seed: int = 0, **changes) -> Case:
    image, label = volume(seed)
    given = {
        "name": f"case{seed}",
        "image": torch.from_numpy(image),
        "label": torch.from_numpy(label != 0),
        "spacing": (0.8, 0.8, 1.25),
        "affine": AFFINE,
        "source": Path(f"case{seed}.nii.gz"),
    }
    return Case(**{**given, **changes})


def write_nnunet(folder: Path, train: int = 3, test: int = 1) -> Path:
    """imagesTr, labelsTr, imagesTs, labelsTs."""
    for part, seeds in (("Tr", range(train)), ("Ts", range(train, train + test))):
        for name in (f"images{part}", f"labels{part}"):
            (folder / name).mkdir(parents=True)
        for seed in seeds:
            image, label = volume(seed)
            nib.save(nib.Nifti1Image(image, AFFINE), folder / f"images{part}" / f"case{seed}_0000.nii.gz")
            nib.save(nib.Nifti1Image(label, AFFINE), folder / f"labels{part}" / f"case{seed}.nii.gz")
    return folder


def write_hdf5(path: Path, image: np.ndarray, label: np.ndarray | None = None, **attributes) -> Path:
    import h5py

    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["image"] = image
        if label is not None:
            file["label"] = label
        file.attrs.update(attributes)
    return path
