"""The data of Juhl's study of simple shapes: images and targets at 64^3, truth at 512^3, from exact maps of meshes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from sdm.core.grid import Grid
from sdm.core.random import generator
from sdm.engine.api import signed_distance_map
from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.losses import clipped_sdf
from sdm.segmentation.data.patches import Patch
from sdm.shapes import Cuboid, Cylinder, Ellipsoid, Family, Rhomboid

TRAIN, TEST, VALIDATION = 19, 6, 3
# Number of the first shape of a part in each family, and how many it has.
SPLITS = {"train": (0, TRAIN), "test": (TRAIN, TEST), "validation": (TRAIN + TEST, VALIDATION)}
SHIFT = 0.3
MARGIN = 1.05
# Of the image's noise, for a contrast of 1.
NOISE = 0.1
SEED = 2019
# Whose values a regression is trained on.
TARGETS = ("voxels", "mesh", "coarse")


@dataclass(frozen=True)
class Shape:
    """One shape.

    Args:
        image: (n,n,n) share of each voxel that is inside, with noise.
        label: (n,n,n) bool, more than half inside.
        targets: Signed distances in coarse voxels, (n,n,n) each. "mesh": exact, of the mesh. "voxels": the distance
            transform of the fine label, sampled at the coarse voxels' centres. "coarse": that of the coarse label.
        truth: (N,N,N) bool, the fine label; None where it is not needed.
    """

    image: Tensor
    label: Tensor
    targets: dict[str, Tensor]
    truth: Tensor | None


def families() -> list[Family]:
    return [family(shift=SHIFT) for family in (Cuboid, Rhomboid, Ellipsoid, Cylinder)]


def grid_of(resolution: int) -> Grid:
    """A cube about the origin that holds every shape of the four families."""
    reach = MARGIN * max(float(torch.stack(family.bounds()).abs().max()) for family in families())
    step = 2 * reach / resolution
    return Grid((step / 2 - reach,) * 3, (step,) * 3, (resolution,) * 3)


def shapes(part: str, fine: int, coarse: int, device: torch.device | str) -> Iterator[Shape]:
    """19 shapes of each family to train on, 6 others to test on, 3 more to choose by: the same on every machine.

    Args:
        part: "train", "test" or "validation".
        fine: Voxels along an axis of the truth, a multiple of `coarse`: 512.
        coarse: Of images and targets: 64.
        device: Where they are made and stay.
    """
    first, count = SPLITS[part]
    fine_grid, coarse_grid = grid_of(fine), grid_of(coarse)
    for family in families():
        theta = family.sample(count, seed=SEED, start=first, device="cpu")
        for row in range(count):
            random = generator(SEED, "noise of an image", family.name, first + row)
            mesh = family.mesh(theta[row].to(device))
            inside = signed_distance_map(mesh, fine_grid, device=device).values < 0
            share = functional.avg_pool3d(inside.float()[None, None], fine // coarse)[0, 0]
            exact = signed_distance_map(mesh, coarse_grid, device=device).values / coarse_grid.spacing[0]
            label = share > 0.5
            targets = {
                "mesh": exact,
                "voxels": _at_coarse(_transform(inside), fine // coarse),
                "coarse": _transform(label),
            }
            noise = NOISE * torch.randn(share.shape, generator=random).to(share)
            yield Shape(share + noise, label, targets, None if part == "train" else inside)


def _transform(label: Tensor) -> Tensor:
    return euclidean_distance_transform(label, signed=True, surface="faces")


def _at_coarse(fine: Tensor, factor: int) -> Tensor:
    """Fine distances at the centres of coarse voxels, in coarse voxels: the mean of the 8 fine voxels around."""
    middle = slice(factor // 2 - 1, factor // 2 + 1)
    blocks = fine.unflatten(2, (-1, factor)).unflatten(1, (-1, factor)).unflatten(0, (-1, factor))
    return blocks[:, middle, :, middle, :, middle].mean((1, 3, 5)) / factor


class ShapeBatches:
    """Batches of whole volumes, each turned by one of the cube's 48 symmetries, which change no value of any map."""

    def __init__(self, source: list[Shape], target: str | None) -> None:
        self.device = source[0].image.device
        self.spacing = (1.0, 1.0, 1.0)
        self.position = False
        self.coarsen = 1
        self._images = torch.stack([s.image for s in source])
        self._labels = torch.stack([s.label for s in source])
        self._maps = None if target is None else clipped_sdf(torch.stack([s.targets[target] for s in source]))

    def batch(self, count: int, *, seed: int, step: int, augment: str = "affine") -> Patch:
        random = generator(seed, "turn of volumes", step)
        # Every shape once in each round through the shuffled list.
        total = len(self._images)
        places = [step * count + row for row in range(count)]
        rounds = {p // total for p in places}
        shuffled = {r: torch.randperm(total, generator=generator(seed, "order of volumes", r)) for r in rounds}
        chosen = torch.stack([shuffled[p // total][p % total] for p in places]).to(self.device)
        axes = (torch.randperm(3, generator=random) + 1).tolist()
        mirrored = [a + 1 for a in range(3) if torch.rand((), generator=random) < 0.5]

        def turned(volumes: Tensor) -> Tensor:
            picked = volumes[chosen]
            if augment != "none":
                picked = picked.permute(0, *axes).flip(mirrored)
            return picked[:, None].contiguous()

        return Patch(turned(self._images), turned(self._labels), None if self._maps is None else turned(self._maps))
