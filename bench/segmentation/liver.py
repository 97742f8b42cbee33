"""Liver tumours for the study of Ma et al.: LiTS, as anyone who has it keeps it, in the layout that trainings read.

    python -m sdm.bench.segmentation.liver prepare Task03_Liver --out liver         # from the Decathlon's copy of LiTS
    python -m sdm.bench.segmentation.ma run --data liver --logs liver.jsonl --mirrors "" --budget-s 36000

The second command is the paper's liver part: every row on the tumours. LiTS (131 labelled CT volumes; 0 background,
1 liver, 2 tumour) asks for a registration, so it was never run here. What is tested instead is a smoke case: a labelled
liver image of 438 x 353 x 165 voxels that comes with Debian's `libcgal-demo`,

    python -m sdm.bench.segmentation.liver smoke liver.inr.gz --out liver

whose intensities are made up from its labels: two cases, good for seeing that everything runs and for nothing else.
"""

from __future__ import annotations

import argparse
import gzip
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import nibabel
import numpy as np

from sdm.errors import FormatError

# Its types say less than its values can do.
nib: Any = nibabel
TUMOUR = 2
# Hounsfield units between which liver and tumours differ.
WINDOW = -200.0, 250.0
# Voxels around the liver.
MARGIN = 20
# Every fifth case is to validate on.
FIFTH = 5
HEADER = 256
# Of the smoke case: which label is to be found, and its noise.
SMOKE_LABEL = 127
NOISE = 20.0


def prepare(source: Path, out: Path) -> int:
    """Write the cases of `imagesTr` and `labelsTr` that have a tumour, cropped to the liver; how many.

    Raises:
        FormatError: There are none.
    """
    images = sorted((source / "imagesTr").glob("*.nii*"), key=_number)
    cases = 0
    for number, path in enumerate(path for path in images if not path.name.startswith(".")):
        image, label = nib.load(path), nib.load(source / "labelsTr" / path.name)
        labels = np.asarray(label.dataobj)
        if not (labels == TUMOUR).any():
            continue
        box = _box(labels > 0)
        values = np.clip(np.asarray(image.dataobj)[box], *WINDOW)
        affine = image.affine.copy()
        affine[:3, 3] += affine[:3, :3] @ [part.start for part in box]
        _write(out, f"liver_{_number(path):03}", values, labels[box] == TUMOUR, affine, number % FIFTH == 0)
        cases += 1
    if not cases:
        raise FormatError(f"{source} holds no cases with tumours: give a folder with imagesTr and labelsTr, as Task03")
    return cases


def smoke(source: Path, out: Path, every: int = 1) -> int:
    """Write two cases with made-up intensities, of a labelled INRIMAGE and of its mirror image, every n-th voxel."""
    labels, spacing = read_inr(source)
    labels = labels[::every, ::every, ::every]
    affine = np.diag([*(every * spacing), 1.0])
    rng = np.random.default_rng(0)
    for number, turned in enumerate((labels, labels[::-1])):
        values = turned + NOISE * rng.standard_normal(turned.shape)
        _write(out, f"smoke_{number}", values, turned == SMOKE_LABEL, affine, number == 1)
    return 2


def read_inr(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values (nx,ny,nz) uint8 and voxel sizes (3,) of an INRIMAGE-4 file of bytes, `.inr` or `.inr.gz`.

    Raises:
        FormatError: It is something else, or cut off.
    """
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    said = dict(re.findall(r"^(\w+)=(.*)$", data[:HEADER].decode("latin-1"), re.MULTILINE))
    if not data.startswith(b"#INRIMAGE-4#") or said.get("PIXSIZE") != "8 bits" or said.get("VDIM") != "1":
        raise FormatError(f"{path} is no INRIMAGE-4 file of one byte a voxel")
    shape = [int(said[key]) for key in ("XDIM", "YDIM", "ZDIM")]
    values = np.frombuffer(data[HEADER:], np.uint8)
    if values.size != np.prod(shape):
        raise FormatError(f"{path} is cut off: {values.size:,} of {np.prod(shape):,} voxels are there")
    return values.reshape(shape, order="F"), np.array([float(said[key]) for key in ("VX", "VY", "VZ")])


def _number(path: Path) -> int:
    digits = re.findall(r"\d+", path.name)
    return int(digits[-1]) if digits else 0


def _box(mask: np.ndarray) -> tuple[slice, ...]:
    places = [np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis))) for axis in range(3)]
    return tuple(slice(max(0, int(at[0]) - MARGIN), int(at[-1]) + MARGIN + 1) for at in places)


def _write(out: Path, name: str, values: np.ndarray, label: np.ndarray, affine: np.ndarray, validation: bool) -> None:
    part = "Ts" if validation else "Tr"
    for folder, ending, array in (
        (f"images{part}", "_0000", values.astype(np.float32)),
        (f"labels{part}", "", label.astype(np.uint8)),
    ):
        (out / folder).mkdir(parents=True, exist_ok=True)
        image = nib.Nifti1Image(array, affine)
        image.header.set_xyzt_units("mm")
        nib.save(image, out / folder / f"{name}{ending}.nii.gz")


def main(argv: Sequence[str] | None = None) -> None:
    """As the module says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("prepare", "smoke"))
    parser.add_argument("source", type=Path, help="Task03_Liver, or liver.inr.gz")
    parser.add_argument("--out", type=Path, required=True, help="folder for imagesTr, labelsTr, imagesTs, labelsTs")
    parser.add_argument("--every", type=int, default=1, help="of the smoke case: every n-th voxel along each axis")
    options = parser.parse_args(argv)
    if options.what == "prepare":
        print(f"{prepare(options.source, options.out)} cases")
    else:
        print(f"{smoke(options.source, options.out, options.every)} cases with made-up intensities")


if __name__ == "__main__":
    main()
