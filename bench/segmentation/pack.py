"""HDF5 cases in one small file and back, for a machine that the data has to travel to.

    python -m sdm.bench.segmentation.pack pack DIR/la la.npz
    python -m sdm.bench.segmentation.pack pack DIR/la la2.npz --coarsen 2    # a fifth of the size
    python -m sdm.bench.segmentation.pack unpack la.npz OUT/la

MRI is recorded in whole numbers; the data's float32 images are these, shifted and scaled. The file holds the whole
numbers, as differences between neighbours, and the unpacked cases hold them as 8 bits. Training standardises every
image, so it sees the same values but for float32's rounding. Labels without images (DIR/la/labels/*.npz: `bits`,
`shape`) are packed too. With --coarsen every cube of so many voxels along each axis has its mean, rounded to a whole
number: all that a training with the same --coarsen sees of an image; labels stay as they are.
`sdm.bench.segmentation.ma --data la.npz` reads the file as it is, which needs no HDF5.
"""

from __future__ import annotations

import argparse
import lzma
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.segmentation import Case
from sdm.segmentation.data.downsample import coarse_image

# Relative to the step between two neighbouring values.
TOLERANCE = 0.02
SHAPES = "labels"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pack", "unpack"))
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--coarsen", type=int, default=1, help="pack: means of cubes of so many voxels along each axis")
    options = parser.parse_args()
    if options.what == "pack":
        pack(options.source, options.target, coarsen=options.coarsen)
    else:
        unpack(options.source, options.target)


def pack(source: Path, target: Path, *, coarsen: int = 1) -> None:
    import h5py

    arrays: dict[str, np.ndarray] = {}
    for path in sorted(source.rglob("*.h5")):
        name = path.relative_to(source).with_suffix("").as_posix()
        with h5py.File(path, "r") as file:
            image, label = np.asarray(file["image"]), np.asarray(file["label"])
        numbers = whole_numbers(image)
        if numbers is None:
            raise SystemExit(f"{path} is not made of at most 256 whole numbers: copy it as it is")
        if coarsen > 1:
            numbers = means_of_cubes(numbers, coarsen)
        arrays[f"{name}:shape"] = np.asarray(image.shape)
        arrays[f"{name}:image"] = squeezed(differences(numbers))
        arrays[f"{name}:label"] = squeezed(np.packbits(label != 0))
    for path in sorted((source / SHAPES).glob("*.npz")):
        with np.load(path) as file:
            arrays[f"{SHAPES}/{path.stem}:shape"], bits = file["shape"], file["bits"]
        arrays[f"{SHAPES}/{path.stem}:label"] = squeezed(bits)
    np.savez(target, allow_pickle=False, **arrays)
    count = sum(name.endswith(":shape") for name in arrays)
    print(f"{target}: {count} cases, {target.stat().st_size / 1e6:.1f} MB")


def unpack(source: Path, target: Path) -> None:
    import h5py

    with np.load(source) as file:
        for name in names_of(file):
            path = target / f"{name}.h5"
            path.parent.mkdir(parents=True, exist_ok=True)
            if f"{name}:image" not in file.files:
                bits = np.packbits(label_of(file, name))
                np.savez_compressed(path.with_suffix(".npz"), bits=bits, shape=file[f"{name}:shape"])
                continue
            with h5py.File(path, "w") as out:
                out.create_dataset("image", data=image_of(file, name))
                out.create_dataset("label", data=label_of(file, name))


def packed_cases(source: Path, part: str) -> list[Case]:
    """The cases of a part of a packed file, as `read_cases` gives those of its folder."""
    with np.load(source) as file:
        return [
            Case(
                name=name.split("/")[-1],
                image=torch.from_numpy(image_of(file, name).astype(np.float32)),
                label=torch.from_numpy(label_of(file, name) != 0),
                spacing=(1.0, 1.0, 1.0),
                affine=np.eye(4),
                source=source,
            )
            for name in names_of(file)
            if name.startswith(f"{part}/")
        ]


def shapes_of(source: Path) -> dict[str, torch.Tensor]:
    """Labels (x,y,z) bool without images, by name: of a packed file, or of the folder `labels` in a data folder."""
    if source.is_file():
        with np.load(source) as file:
            names = [name for name in names_of(file) if name.startswith(f"{SHAPES}/")]
            return {name.split("/")[1]: torch.from_numpy(label_of(file, name) != 0) for name in names}
    found = {}
    for path in sorted((source / SHAPES).glob("*.npz")):
        with np.load(path) as file:
            found[path.stem] = torch.from_numpy(unpacked_bits(file["bits"], tuple(file["shape"])) != 0)
    return found


def names_of(file: Any) -> list[str]:
    return sorted({key.split(":")[0] for key in file.files})


def image_of(file: Any, name: str) -> np.ndarray:
    """Whole numbers (x,y,z) uint8."""
    content = np.frombuffer(lzma.decompress(file[f"{name}:image"].tobytes()), np.uint8)
    return sums(content.reshape(tuple(file[f"{name}:shape"])))


def label_of(file: Any, name: str) -> np.ndarray:
    """(x,y,z) uint8, 0 or 1."""
    bits = np.frombuffer(lzma.decompress(file[f"{name}:label"].tobytes()), np.uint8)
    return unpacked_bits(bits, tuple(file[f"{name}:shape"]))


def unpacked_bits(bits: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.unpackbits(bits, count=math.prod(int(n) for n in shape)).reshape(shape)


def means_of_cubes(numbers: np.ndarray, edge: int) -> np.ndarray:
    """Each voxel's cube of `edge`^3 as `coarse_image` takes it, by its rounded mean: (x,y,z) uint8, the same shape."""
    means = coarse_image(torch.from_numpy(numbers).float(), edge).round().to(torch.uint8)
    for axis, count in enumerate(numbers.shape):
        means = means.repeat_interleave(edge, axis).narrow(axis, 0, count)
    return means.numpy()


def differences(numbers: np.ndarray) -> np.ndarray:
    """Differences along the first two axes, modulo 256: small where an image is smooth."""
    for axis in (0, 1):
        numbers = np.diff(numbers, axis=axis, prepend=np.uint8(0))
    return numbers


def sums(values: np.ndarray) -> np.ndarray:
    """The inverse of `differences`."""
    for axis in (0, 1):
        values = np.cumsum(values, axis=axis, dtype=np.uint8)
    return values


def squeezed(values: np.ndarray) -> np.ndarray:
    return np.frombuffer(lzma.compress(np.ascontiguousarray(values).tobytes()), np.uint8)


def whole_numbers(image: np.ndarray) -> np.ndarray | None:
    """The 8-bit whole numbers that an image was made of, shifted and scaled; None if there are none such."""
    values = np.unique(image).astype(np.float64)
    if len(values) < 2:
        return None
    step = np.diff(values).min()
    # Refine the step by the largest value, which is many steps away.
    step = (values[-1] - values[0]) / round((values[-1] - values[0]) / step)
    found = np.round((image.astype(np.float64) - values[0]) / step)
    if found.max() > 255 or np.abs(found * step + values[0] - image).max() > TOLERANCE * step:
        return None
    return found.astype(np.uint8)


if __name__ == "__main__":
    main()
