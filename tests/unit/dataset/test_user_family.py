"""Datasets of a user's own family: another formula under the same name never goes into what is there."""

from __future__ import annotations

import pytest
import torch

from sdm.dataset import SDMDataset, damaged, generate, verify
from sdm.dataset.manifest import read_manifest
from sdm.errors import FormatError, SDMError
from sdm.shapes import Cochlea, load_family
from sdm.shapes.named_family import family_record
from sdm.shapes.solids import Ellipsoid
from sdm.stream import SDMStream

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


def test_the_stream_of_a_record_is_the_one_it_was_made_from(tmp_path):
    family = Cochlea(600)
    (tmp_path / "shapes").mkdir()
    egg(tmp_path, 1.0)
    file = f"{tmp_path / 'egg.py'}:Egg"
    for number, (source, named, own) in enumerate(
        (
            ({"family": "cochlea", "triangles": 600}, None, family),
            ({"file": file, "reference": family_record(load_family(file))}, file, load_family(file)),
        )
    ):
        path = tmp_path / f"{number}.zarr"
        recipe = {"seed": 5, "sampler": "chebyshev", "dtype": torch.float16, "truncate": 1.0}
        generate(own, own.grid(8), 6, path, shard=3, device="cpu", source=source, **recipe)
        data = SDMDataset(path)
        stream = data.stream(named, 4, device="cpu")
        assert stream.maker.recipe == data.manifest["recipe"]
        first, second = next(it := iter(stream)), next(it)
        assert torch.equal(first.sdm, torch.stack([data[i].sdm for i in range(4)]))
        assert torch.equal(second.theta[:2], data.theta[4:])
        assert torch.equal(next(iter(data.stream(named, 2, device="cpu", start=4))).sdm, second.sdm[:2])
        original = SDMStream(own, own.grid(8), 4, device="cpu", **recipe)
        assert original.state_dict()["recipe"] == stream.state_dict()["recipe"]
        assert all(torch.equal(a, b) for a, b in zip(next(iter(original)), first, strict=True))


def test_no_stream_of_a_record_by_another_family_or_by_code_that_nobody_named(tmp_path):
    egg(tmp_path, 1.0)
    file = f"{tmp_path / 'egg.py'}:Egg"
    own = load_family(file)
    source = {"file": file, "reference": family_record(own)}
    path = generate(own, own.grid(8), 4, tmp_path / "a.zarr", shard=2, device="cpu", source=source)
    # The record names it; that runs nothing.
    (tmp_path / "egg.py").write_text("raise RuntimeError('run')")
    data = SDMDataset(path)
    with pytest.raises(SDMError, match=r"is code, .*egg.py:Egg, which is run only where you name it: give it"):
        data.stream(device="cpu")
    with pytest.raises(SDMError, match="egg is not the family that the dataset was made from: other vertices"):
        data.stream(egg(tmp_path, 1.01), device="cpu")
    with pytest.raises(SDMError, match=r"seed is as in the record of .*: leave it out"):
        data.stream(own, device="cpu", seed=3)
    unsaid = SDMDataset(made(Cochlea(600), tmp_path / "b.zarr"))
    with pytest.raises(SDMError, match="record does not say what 'cochlea' is: give the family"):
        unsaid.stream(device="cpu")
    with pytest.raises(SDMError, match=r"cochlea is not the family .*: other faces or constants"):
        unsaid.stream("cochlea", device="cpu")
    assert torch.equal(next(iter(unsaid.stream(Cochlea(600), 4, device="cpu"))).theta, unsaid.theta)
