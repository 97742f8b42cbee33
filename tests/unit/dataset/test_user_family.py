"""Datasets of a user's own family: another formula under the same name never goes into what is there."""

from __future__ import annotations

import pytest

from sdm.dataset import damaged, generate, verify
from sdm.dataset.manifest import read_manifest
from sdm.errors import FormatError
from sdm.shapes import Cochlea, load_family
from sdm.shapes.solids import Ellipsoid

SWELLS = """
from sdm.shapes.solids import Ellipsoid

class Egg(Ellipsoid):
    name = "egg"

    def vertices(self, theta):
        return super().vertices(theta) * {factor}
"""


def egg(folder, factor):
    (folder / "egg.py").write_text(SWELLS.format(factor=factor))
    return load_family(f"{folder / 'egg.py'}:Egg")


def made(family, path, **options):
    return generate(family, family.grid(8), 4, path, shard=2, device="cpu", **options)


def test_a_damaged_shard_is_not_made_again_by_another_formula(tmp_path):
    family = egg(tmp_path, 1.0)
    path = made(family, tmp_path / "d.zarr")
    assert read_manifest(path)["source"]["reference"]["name"] == "egg"
    shard = sorted(p for p in (path / "sdm").rglob("*") if p.is_file() and p.name != "zarr.json")[1]
    before = shard.read_bytes()
    shard.write_bytes(before[:100] + b"x" + before[101:])
    assert len(damaged(path)) == 1
    with pytest.raises(FormatError, match="the egg it was made with had other vertices: made again they would differ"):
        verify(path, egg(tmp_path, 1.01), device="cpu")
    assert verify(path, egg(tmp_path, 1.0), device="cpu") == [1]
    assert shard.read_bytes() == before


def test_a_dataset_does_not_go_on_with_another_formula(tmp_path):
    path = made(egg(tmp_path, 1.0), tmp_path / "d.zarr")
    assert made(egg(tmp_path, 1.0), path, resume=True) == path
    with pytest.raises(FormatError, match="begun from another egg: other vertices than requested now"):
        made(egg(tmp_path, 1.01), path, resume=True)


def test_families_of_the_package_go_by_its_version(tmp_path):
    assert read_manifest(made(Cochlea(600), tmp_path / "a.zarr"))["source"] is None
    assert read_manifest(made(Ellipsoid(), tmp_path / "b.zarr"))["source"] is None
