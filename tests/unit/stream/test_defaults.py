"""torch's default type and device are the caller's: no sample depends on them."""

from __future__ import annotations

import pytest
import torch

from sdm.core.demo_mesh import demo_mesh
from sdm.dataset import SDMDataset, generate
from sdm.deepsdf.samples import ShapeSet
from sdm.shapes import Cochlea, MeshFolder, grid
from sdm.stream import SDMStream


@pytest.fixture(params=["float64", "meta"])
def other_default(request):
    """Torch with another default from here on."""

    def change() -> None:
        if request.param == "float64":
            torch.set_default_dtype(torch.float64)
        else:
            torch.set_default_device("meta")

    yield change
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)


def same_with(other_default, make) -> None:
    expected = make()
    other_default()
    found = make()
    for one, other in zip(expected, found, strict=True):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)


@pytest.mark.parametrize("sampler", ["uniform", "sobol", "chebyshev", "grid:5", "grid:3:ordered", "mixture:0.5"])
def test_samples(sampler, other_default):
    def make():
        family = Cochlea(600)
        return SDMStream(family, family.grid(8), 4, device="cpu", sampler=sampler).sample([0, 3, 700])

    same_with(other_default, make)


def test_tensor_grid(other_default):
    same_with(other_default, lambda: [grid(3, 2), Cochlea(600).grid_samples(3, device="cpu")])


def test_datasets_of_a_folder(other_default, tmp_path):
    places = iter((tmp_path / "a.zarr", tmp_path / "b.zarr"))

    def make():
        family = MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3)])
        made = SDMDataset(generate(family, family.grid(8), 3, next(places), device="cpu"))
        return [*made[1], made.inverse_transform(1), *family.bounds()]

    same_with(other_default, make)


def test_points_of_shapes(other_default):
    def make():
        shapes = ShapeSet([demo_mesh(rings=41, segments=16, cap_rings=3)] * 3, "cpu")
        return shapes.sample(torch.tensor([0, 2], device="cpu"), 50)

    same_with(other_default, make)
