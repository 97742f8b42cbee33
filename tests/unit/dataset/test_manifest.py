"""Damaged manifests, and parameters whose bits have flipped: one sentence, never another dataset."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from sdm.cli.app import main
from sdm.core.demo_mesh import demo_mesh
from sdm.dataset import SDMDataset, damaged, generate, layout, verify
from sdm.dataset.manifest import CHECKSUM, KEY, read_manifest, sealed
from sdm.dataset.shard_paths import file_of
from sdm.errors import FormatError
from sdm.shapes import Cochlea, MeshFolder

FAMILY = Cochlea(600)
COUNT = 5
KEYS = (
    *("version", "sign", "recipe", "count", "shard", "compression", "parameters", "transforms", "rejected"),
    *("sdm_version", "device", "source"),
    *(f"recipe.{key}" for key in ("family", "fingerprint", "grid", "seed", "sampler", "draws", "dtype", "truncate")),
    *(f"recipe.grid.{key}" for key in ("origin", "spacing", "shape", "direction")),
    *(f"parameters.0.{key}" for key in ("name", "low", "high", "unit")),
)
# Values that no key may have, or that fit one key and not another.
STRANGE = (-1, "x", [], [[]], {"x": 1}, 0.5, True, None)


def source() -> dict[str, Any]:
    return {"family": "cochlea", "triangles": 600}


def write(path: Path, **options: Any) -> Path:
    return generate(FAMILY, FAMILY.grid(6), COUNT, path, shard=3, device="cpu", source=source(), **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("whole") / "d.zarr")


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "d.zarr")


@pytest.fixture(params=[1, 2])
def version(request: pytest.FixtureRequest, copy: Path) -> int:
    """Each version of the layout in turn."""
    if request.param == 1:
        edit(copy, lambda manifest: manifest.update(version=1))
    return request.param


def edit(folder: Path, change: Callable[[dict[str, Any]], object], *, seal: bool = True) -> None:
    document = json.loads((folder / "zarr.json").read_text())
    manifest = document["attributes"][KEY]
    change(manifest)
    if seal:
        document["attributes"][KEY] = sealed(manifest)
    (folder / "zarr.json").write_text(json.dumps(document))


def place(manifest: Any, key: str) -> tuple[Any, Any]:
    *way, last = (int(part) if part.isdigit() else part for part in key.split("."))
    for part in way:
        manifest = manifest[part]
    return manifest, last


def is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> bool:
    """True if every way to a dataset gives one sentence."""
    with pytest.raises(FormatError) as error:
        SDMDataset(folder)
    assert "\n" not in str(error.value)
    for option in ("--verify", "--resume"):
        assert main(["generate", option, "-o", str(folder), "--device", "cpu"]) == 2
        said = capsys.readouterr().err
        assert said.startswith("sdm: ")
        assert said.count("\n") == 1
    return True


@pytest.mark.parametrize("key", [key for key in KEYS if key != "recipe.draws"])
def test_a_key_that_is_gone(version, copy, key):
    edit(copy, remover(key), seal=key != "version" and version > 1)
    with pytest.raises(FormatError, match="the manifest of") as error:
        SDMDataset(copy)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["version", "count", "recipe.grid", "recipe.seed"])
def test_commands_say_so_too(copy, key, capsys):
    edit(copy, remover(key), seal=False)
    assert is_refused(copy, capsys)


def remover(key: str) -> Callable[[dict[str, Any]], None]:
    def remove(manifest: dict[str, Any]) -> None:
        node, last = place(manifest, key)
        del node[last]

    return remove


@pytest.mark.parametrize("key", KEYS)
def test_a_key_of_another_type(version, copy, key):
    """Refused, or the value is one that this key may have; never another kind of error."""
    kept, refused = (copy / "zarr.json").read_text(), 0
    for strange in STRANGE:

        def replace(manifest: dict[str, Any], strange: Any = strange) -> None:
            node, last = place(manifest, key)
            node[last] = strange

        (copy / "zarr.json").write_text(kept)
        edit(copy, replace, seal=key != "version" and version > 1)
        with suppress(FormatError):
            read_manifest(copy)
            continue
        refused += 1
    assert refused >= len(STRANGE) - 3


def test_any_other_value_is_found_by_the_checksum(copy):
    def move(manifest: dict[str, Any]) -> None:
        manifest["recipe"]["grid"]["origin"][0] += 1e-9

    edit(copy, move, seal=False)
    with pytest.raises(FormatError, match=r"is not what sdm wrote: get that file again"):
        SDMDataset(copy)
    edit(copy, lambda manifest: manifest.pop(CHECKSUM), seal=False)
    with pytest.raises(FormatError, match=r"is not what sdm wrote"):
        SDMDataset(copy)


@pytest.mark.parametrize("count", [10**12, 7, 2])
def test_a_count_that_is_not_true(copy, count, capsys):
    edit(copy, lambda manifest: manifest.update(version=1, count=count))
    assert is_refused(copy, capsys)


@pytest.mark.parametrize("bit", [0, 5, 7])
def test_flipped_bits_of_parameters(copy, bit):
    path = file_of(copy, "theta", 1)
    content = bytearray(path.read_bytes())
    content[3] ^= 1 << bit
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"theta of .* is damaged: sdm generate --verify makes it again"):
        SDMDataset(copy)
    assert damaged(copy) == [1]
    assert main(["generate", "--verify", "-o", str(copy), "--device", "cpu"]) is not None
    assert damaged(copy) == []


def test_pieces_of_no_size_are_damage(copy):
    document = json.loads((copy / "sdm" / "zarr.json").read_text())
    document["codecs"][0]["configuration"]["chunk_shape"][0] = 0
    (copy / "sdm" / "zarr.json").write_text(json.dumps(document))
    with pytest.raises(FormatError, match="its array sdm is damaged; sdm generate --verify mends it"):
        SDMDataset(copy)[0]
    assert layout.mend_arrays(copy, read_manifest(copy)) == ["sdm"]
    assert SDMDataset(copy)[0].sdm.isfinite().all()


@pytest.mark.parametrize("name", ["sdm", "theta"])
@pytest.mark.parametrize("size", [6, 99999999999])
def test_sizes_of_arrays_that_are_not_the_manifests(copy, name, size):
    """No memory is asked for by what a damaged description says."""
    document = json.loads((copy / name / "zarr.json").read_text())
    document["chunk_grid"]["configuration"]["chunk_shape"][0] = size
    (copy / name / "zarr.json").write_text(json.dumps(document))
    with pytest.raises(FormatError, match=f"its array {name} is damaged; sdm generate --verify mends it"):
        SDMDataset(copy)[0]
    assert layout.mend_arrays(copy, read_manifest(copy)) == [name]
    assert len(SDMDataset(copy)[0].theta) == len(FAMILY.parameters)


def test_flipped_bits_of_transforms(tmp_path):
    family = MeshFolder([demo_mesh(rings=9, segments=6, cap_rings=2)])
    path = generate(family, family.grid(6), 3, tmp_path / "d.zarr", shard=2, device="cpu")
    data = SDMDataset(path)
    matrix = data.inverse_transform(2)
    part = file_of(path, "transform", 1)
    content = bytearray(part.read_bytes())
    content[6] ^= 1
    part.write_bytes(content)
    with pytest.raises(FormatError, match=r"transform of .* is damaged"):
        data.inverse_transform(2)
    assert not torch.equal(data.inverse_transform(1), matrix)


@pytest.mark.parametrize("old", [True, False])
def test_samples_of_other_random_numbers_are_not_mixed_in(whole, copy, old, capsys):
    """An older dataset is read and its sound shards are kept, but no sample is made for it; a newer one likewise."""
    edit(copy, lambda manifest: manifest["recipe"].pop("draws") if old else manifest["recipe"].update(draws=3))
    np.testing.assert_array_equal(SDMDataset(copy).theta, SDMDataset(whole).theta)
    assert verify(copy, FAMILY, device="cpu") == []
    file_of(copy, "sdm", 1).unlink()
    with pytest.raises(FormatError, match=f"version {1 if old else 3} of the random numbers"):
        verify(copy, FAMILY, device="cpu")
    with pytest.raises(FormatError, match=f"version {1 if old else 3} of the random numbers"):
        write(copy, resume=True)
    assert main(["generate", "--verify", "-o", str(copy), "--device", "cpu"]) == 2
    copy.rename(layout.part_of(copy))
    assert main(["generate", "--resume", "-o", str(copy), "--device", "cpu"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert sum("of the random numbers" in line for line in said) == 2
    assert not file_of(layout.part_of(copy), "sdm", 1).exists()


def test_datasets_of_version_1_are_read_and_finished(whole, tmp_path, monkeypatch):
    """Their parameters have no checksums, neither those that are there nor those that are added."""
    monkeypatch.setattr("sdm.dataset.writer.VERSION", 1)
    old = write(tmp_path / "d.zarr")
    monkeypatch.undo()
    assert file_of(old, "theta", 0).stat().st_size == 3 * 4 * len(FAMILY.parameters)
    assert CHECKSUM not in json.loads((old / "zarr.json").read_text())["attributes"][KEY]
    expected, found = SDMDataset(whole), SDMDataset(old)
    np.testing.assert_array_equal(found.theta, expected.theta)
    assert torch.equal(found[4].sdm, expected[4].sdm)
    before = file_of(old, "theta", 1).read_bytes()
    old.rename(layout.part_of(old))
    file_of(layout.part_of(old), "theta", 1).unlink()
    assert layout.mend_arrays(layout.part_of(old), read_manifest(layout.part_of(old))) == []
    write(old, resume=True)
    assert file_of(old, "theta", 1).read_bytes() == before
