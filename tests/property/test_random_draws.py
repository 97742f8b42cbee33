"""Random things share no draws with their neighbours: other seeds, steps, places in a batch, families and samplers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from sdm.bench.segmentation.juhl_shapes import Shape, ShapeBatches
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf.infer.scan import Scan
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.samples import ShapeSet, surface_points
from sdm.deepsdf.train.batches import Batches
from sdm.deepsdf.train.settings import Settings
from sdm.fit.model.exact import ExactBackend
from sdm.fit.study.simulate import random_state
from sdm.segmentation.data.augment import draw
from sdm.shapes import Cochlea, Cuboid, Cylinder, Ellipsoid, Family, GeometricShapes, MeshFolder, Rhomboid
from sdm.stream import as_sampler
from sdm.surrogate.train.map_buffer import Replay

# Neighbours, and those that linear mixtures of seed and step make the same, such as seed 0 at step 1,000,003 and seed 1
# at step 0, or that differ by a power of two.
SEEDS = (0, 1, 2, -1, 999_983, 1_000_003, 2**32, 2**63, 2**64, 2**64 + 1)
STEPS = (0, 1, 2, 4099, 7919, 999_983, 1_000_003)
ROWS = (0, 1, 2, 4099)
NUMBERS = (0, 1, 2, 1_000_003, 2**32, 2**40)
FAMILIES: dict[str, Callable[[], Family]] = {
    "cochlea": lambda: Cochlea(500),
    "cuboid": lambda: Cuboid(triangles=12),
    "rhomboid": lambda: Rhomboid(triangles=12),
    "ellipsoid": lambda: Ellipsoid(triangles=12),
    "cylinder": lambda: Cylinder(triangles=12),
    "geometric-shapes": lambda: GeometricShapes(triangles=12),
    "mesh-folder": lambda: MeshFolder([mesh()]),
}
SAMPLERS = ("uniform", "sobol", "chebyshev")
SMALL: dict[str, Any] = {"width": 16, "layers": 5, "global_size": 8}


# Made when a test asks, and not as tests are collected: every process collects all, and would compile their kernels.
@cache
def mesh() -> TriangleMesh:
    return Ellipsoid(triangles=300).mesh([0.5, 0.4, 0.3, 0.1, 0.2, 0.3])


@cache
def shapes() -> ShapeSet:
    return ShapeSet([mesh(), mesh()], "cpu")


@cache
def family_of(name: str) -> Family:
    return FAMILIES[name]()


def sample(seed: int, family: str, sampler: str, number: int) -> Tensor:
    own = family_of(family)
    return own.to_unit(as_sampler(sampler).theta(own, seed, torch.tensor([number])))[0, :4]


def static_order(seed: int, family: str, number: int) -> Tensor:
    index = torch.arange(625 * number, 625 * number + 625)
    return as_sampler("grid:5")._places(family_of(family), 625, seed, index)  # type: ignore[attr-defined]


def patch(seed: int, step: int, row: int) -> list[float]:
    d = draw(seed, step, row, 1 << 40, "scanner")
    return [d.case / 2**40, *d.place.tolist(), d.scale, d.gain, d.shift, d.seed / 2**63, d.noise, d.gamma, d.shading]


class NoStream(list[Any]):
    """A stream that gives nothing."""

    device, batch_size = torch.device("cpu"), 1


def stored_maps(seed: int, step: int) -> Tensor:
    store = Replay(NoStream(), 64, seed)  # type: ignore[arg-type]
    store.theta[:] = torch.arange(64.0)[:, None]
    store.count = 64
    return store.theta[store.draw(12, step)][:, 0]


def volumes(seed: int, step: int) -> Tensor:
    some = torch.rand(20, 3, 3, 3, generator=torch.Generator().manual_seed(0))
    batches = ShapeBatches([Shape(image, image > 0.5, {}, None) for image in some], None)
    return batches.batch(20, seed=seed, step=step).image


def weights(seed: int) -> Tensor:
    return next(AutoDecoder(Settings(seed=seed, **SMALL), 1).decoder.parameters())


def scan(seed: int, step: int) -> Tensor:
    return Scan(surface_points(mesh(), 10_000)[0], count=64, seed=seed)(step).points


STEP, FAMILY, NUMBER = {"step": STEPS}, {"family": tuple(FAMILIES)}, {"number": NUMBERS}
# Each: its draws, the values of their arguments besides the seed, and False if draws need to differ as a whole only,
# since their members are always the same or few.
THINGS: dict[str, tuple[Callable[..., Any], dict[str, tuple[Any, ...]], bool]] = {
    "samples of a family": (sample, {**FAMILY, "sampler": SAMPLERS, **NUMBER}, True),
    "order of a static set": (static_order, {**FAMILY, "number": (0, 1, 2)}, False),
    "patch of a segmentation": (patch, {**STEP, "row": ROWS}, True),
    "maps that a surrogate sees": (stored_maps, STEP, False),
    "weights of DeepSDF": (weights, {}, True),
    "codes of DeepSDF": (lambda seed: AutoDecoder(Settings(seed=seed, **SMALL), 8).codes, {}, True),
    "order of DeepSDF": (lambda seed, step: Batches(64, 64, seed)[step], STEP, False),
    "samples of DeepSDF": (
        lambda seed, step, shape, points: shapes().sample(torch.tensor([shape]), points, seed=seed, step=step).points,
        {**STEP, "shape": (0, 1), "points": (8, 16)},
        True,
    ),
    "points of a surface": (lambda seed: surface_points(mesh(), 32, seed=seed)[0], {}, True),
    "points of a scan": (scan, STEP, False),
    "state to fit": (lambda seed: random_state(ExactBackend(family_of("cochlea"), "cpu"), seed).theta, {}, True),
    "volumes of the study of shapes": (volumes, STEP, False),
}  # fmt: skip


@pytest.mark.parametrize("name", THINGS)
def test_neighbours_share_no_draws(name):
    make, axes, each = THINGS[name]
    cases = list(product(SEEDS, *axes.values()))
    drawn = [torch.as_tensor(make(*case)).detach().double().reshape(-1)[:64].numpy() for case in cases]
    width = min(map(len, drawn))
    assert width >= 4
    # What differs by rounding is the same draw.
    table = np.round(np.stack([row[:width] for row in drawn]), 5)
    # One number may come again by chance.
    most = 1 if each else width - 1
    for place, row in enumerate(table):
        alike = (table[place + 1 :] == row).sum(1)
        again = [cases[place + 1 + int(other)] for other in np.flatnonzero(alike > most)]
        assert not again, f"{cases[place]} draws as {again[0]}"


def test_the_same_again():
    for make, axes, _ in THINGS.values():
        case = (3, *(values[1] for values in axes.values()))
        assert torch.equal(*(torch.as_tensor(make(*case)).detach() for _ in range(2)))
