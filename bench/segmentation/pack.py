"""HDF5 cases in one small file and back, for a machine that the data has to travel to.

    python -m sdm.bench.segmentation.pack pack DIR/la la.npz
    python -m sdm.bench.segmentation.pack unpack la.npz OUT/la

MRI is recorded in whole numbers; the data's float32 images are these, shifted and scaled. The file holds the whole
numbers, as differences between neighbours, and the unpacked cases hold them as 8 bits. Training standardises every
image, so it sees the same values but for float32's rounding.
"""

from __future__ import annotations

import argparse
import lzma
from pathlib import Path

import h5py
import numpy as np

# Relative to the step between two neighbouring values.
TOLERANCE = 0.02


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pack", "unpack"))
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    options = parser.parse_args()
    (pack if options.what == "pack" else unpack)(options.source, options.target)


def pack(source: Path, target: Path) -> None:
    arrays: dict[str, np.ndarray] = {}
    for path in sorted(source.rglob("*.h5")):
        name = path.relative_to(source).with_suffix("").as_posix()
        with h5py.File(path, "r") as file:
            image, label = np.asarray(file["image"]), np.asarray(file["label"])
        numbers = whole_numbers(image)
        if numbers is None:
            raise SystemExit(f"{path} is not made of at most 256 whole numbers: copy it as it is")
        arrays[f"{name}:shape"] = np.asarray(image.shape)
        arrays[f"{name}:image"] = squeezed(differences(numbers))
        arrays[f"{name}:label"] = squeezed(np.packbits(label != 0))
    np.savez(target, allow_pickle=False, **arrays)
    print(f"{target}: {len(arrays) // 3} cases, {target.stat().st_size / 1e6:.1f} MB")


def unpack(source: Path, target: Path) -> None:
    with np.load(source) as file:
        for name in sorted({key.split(":")[0] for key in file.files}):
            shape = tuple(file[f"{name}:shape"])
            image = sums(np.frombuffer(lzma.decompress(file[f"{name}:image"].tobytes()), np.uint8).reshape(shape))
            bits = np.frombuffer(lzma.decompress(file[f"{name}:label"].tobytes()), np.uint8)
            label = np.unpackbits(bits, count=image.size).reshape(shape)
            path = target / f"{name}.h5"
            path.parent.mkdir(parents=True, exist_ok=True)
            with h5py.File(path, "w") as out:
                out.create_dataset("image", data=image)
                out.create_dataset("label", data=label)


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
