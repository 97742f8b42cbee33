"""The shapes of the DeepSDF studies: cochleas by parameters, left atria from labels.

    python -m sdm.bench.deepsdf.shapes --data ../shared/data --out FILE.npz

packs the labels of the left-atrium data (h5 files of `la/train` and `la/val`, bits of `la/labels`) into one small file,
for machines that have only that. It holds data of others under their terms (see the data's README): do not publish it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch

from sdm.bench.common.checkout import data_folder
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import label_surface
from sdm.errors import FormatError
from sdm.io.files.torch_file import save_torch
from sdm.shapes import Cochlea

# Of the 2018 challenge's volumes as they are processed here.
SPACING_MM = 0.625
TRAINING, TEST = ("train", "labels"), ("val",)
# Far from the seeds of trainings: test cochleas are others.
COCHLEA_SEED, TEST_SEED = 500, 77_000


@dataclass(frozen=True)
class Shapes:
    """Meshes of a class in mm, to train on and to test on, by name."""

    training: list[TriangleMesh]
    test: list[TriangleMesh]


def cochleas(count: int, test: int, *, triangles: int = 6_000, device: str = "cpu") -> Shapes:
    """Random cochleas, uniform in the family's box."""
    family = Cochlea(triangles)

    def some(number: int, seed: int) -> list[TriangleMesh]:
        theta = family.sample(number, seed=seed, device=device)
        vertices, faces = family.vertices(theta), family.faces_on(device)
        return [TriangleMesh(v, faces, f"cochlea-{seed}-{i}", check=False) for i, v in enumerate(vertices)]

    return Shapes(some(count, COCHLEA_SEED), some(test, TEST_SEED))


def atria(source: Path, count: int | None = None, test: int | None = None, *, cache: Path | None = None) -> Shapes:
    """Smooth surfaces of left atria: the 72 labels of `train` and `labels`, and the 8 of `val`.

    Args:
        source: The data folder, or the file that this command packs.
        count: How many to train on; all if not given.
        test: How many to test on.
        cache: A file that keeps the surfaces for the next time.
    """
    if cache is None or not cache.exists():
        found = _surfaces(source)
        if cache is not None:
            cache.parent.mkdir(parents=True, exist_ok=True)
            save_torch([[(m.vertices, m.faces, m.name) for m in group] for group in found], cache)
    else:
        kept = torch.load(cache, weights_only=True)
        found = [[TriangleMesh(v, f, name, check=False) for v, f, name in group] for group in kept]
    return Shapes(found[0][:count], found[1][:test])


def _surfaces(source: Path) -> list[list[TriangleMesh]]:
    """Of the training and of the test labels, on all cores."""
    with np.load(source) if source.is_file() else _Folder(source) as file:
        names = sorted(n.removesuffix("/bits") for n in file.files if n.endswith("/bits"))
        groups = [[n for n in names if n.split("/")[0] in chosen] for chosen in (TRAINING, TEST)]
        labels = [[(n.split("/")[1], file[f"{n}/bits"], file[f"{n}/shape"]) for n in group] for group in groups]
    if not all(labels):
        raise FormatError(f"{source} holds no left atria; give the data folder, or a file packed from it")
    cores = len(os.sched_getaffinity(0))
    if cores <= 2:
        return [[_mesh(*label) for label in group] for group in labels]
    # Processes of their own: marching cubes holds the interpreter's lock.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(cores, context, torch.set_num_threads, (1,)) as pool:
        return [list(pool.map(_mesh, *zip(*group, strict=True), chunksize=1)) for group in labels]


def left_out_labels(source: Path, count: int | None = None) -> dict[str, torch.Tensor]:
    """Masks (x,y,z) of the test atria by name, voxels of `SPACING_MM` with the first at the surfaces' origin."""
    with np.load(source) if source.is_file() else _Folder(source) as file:
        paths = sorted(n.removesuffix("/bits") for n in file.files if n.endswith("/bits") and n.split("/")[0] in TEST)
        return {p.split("/")[1]: _mask(file[f"{p}/bits"], file[f"{p}/shape"]) for p in paths[:count]}


def _mask(bits: np.ndarray, shape: np.ndarray) -> torch.Tensor:
    x, y, z = (int(n) for n in shape)
    return torch.from_numpy(np.unpackbits(bits, count=x * y * z).reshape(x, y, z))


def _mesh(name: str, bits: np.ndarray, shape: np.ndarray) -> TriangleMesh:
    mesh = label_surface(_mask(bits, shape), SPACING_MM)
    return TriangleMesh(mesh.vertices, mesh.faces, name, check=False)


class _Folder:
    """The data folder, read as if it were the packed file."""

    def __init__(self, folder: Path) -> None:
        found = [p for group in (*TRAINING, *TEST) for p in sorted((folder / "la" / group).glob("*"))]
        self._paths = {f"{p.parent.name}/{p.stem}": p for p in found if p.suffix in (".h5", ".npz")}
        self.files = [f"{name}/{part}" for name in self._paths for part in ("bits", "shape")]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def __getitem__(self, key: str) -> np.ndarray:
        name, part = key.rsplit("/", 1)
        path = self._paths[name]
        if path.suffix == ".npz":
            with np.load(path) as file:
                return file[part]
        import h5py

        with h5py.File(path, "r") as file:
            label = np.asarray(file["label"]) != 0
        return np.packbits(label) if part == "bits" else np.array(label.shape)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder())
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    with _Folder(options.data) as folder:
        content = {name: folder[name] for name in folder.files}
    if not content:
        raise SystemExit(f"{options.data} holds no folder la with labels")
    part = options.out.with_suffix(".part.npz")
    save: Any = np.savez_compressed
    save(part, **content)
    part.replace(options.out)
    print(f"{options.out}: {len(content) // 2} labels, {options.out.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
