"""Meshes, maps and datasets by addresses: memory:// stands for an object store, file:// for a disk."""

from __future__ import annotations

import pickle

import fsspec
import pytest
import torch
import trimesh
from torch.utils.data import DataLoader

import sdm
from sdm.dataset import SDMDataset, generate
from sdm.errors import FormatError, MeshError
from sdm.io.files import remote
from sdm.io.files.remote import is_remote
from sdm.shapes import Cochlea


@pytest.fixture(params=["memory", "file"])
def base(request, tmp_path):
    """The address of an empty folder."""
    if request.param == "file":
        (tmp_path / "far").mkdir()
        yield f"file://{tmp_path}/far"
        return
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    yield "memory://bucket"
    memory.store.clear()


def bring(local, address: str) -> None:
    files, path = fsspec.core.url_to_fs(address)
    files.put(str(local), path, recursive=local.is_dir())


def test_what_is_an_address():
    assert all(map(is_remote, ("s3://a/b.ply", "memory://x", "gcs://y", "https://z/a.npz")))
    assert not any(map(is_remote, ("a.ply", "C:\\a.ply", "c://a.ply", "/s3://a", "s3:/a", ":/a")))


def test_a_mesh(base, tmp_path):
    ball = trimesh.creation.icosphere(2)
    ball.export(tmp_path / "ball.stl")
    bring(tmp_path / "ball.stl", f"{base}/ball.stl")
    here, there = sdm.load_mesh(tmp_path / "ball.stl"), sdm.load_mesh(f"{base}/ball.stl")
    assert torch.equal(here.vertices, there.vertices)
    assert torch.equal(here.faces, there.faces)
    assert there.name == "ball.stl"
    found = sdm.signed_distance_map(f"{base}/ball.stl", 8, device="cpu")
    assert torch.equal(found.values, sdm.signed_distance_map(here, 8, device="cpu").values)


@pytest.mark.parametrize("ending", ["npz", "nii.gz", "zarr"])
def test_a_map_there_and_back(base, ending):
    field = sdm.signed_distance_map(trimesh.creation.icosphere(2), 8, device="cpu")
    for values in (field.values + 1, field.values):
        # What is there is replaced.
        sdm.save(field.with_values(values), f"{base}/map.{ending}")
        again = sdm.load(f"{base}/map.{ending}")
        assert torch.equal(again.values, values)
        assert again.grid == field.grid


def test_a_dataset(base, tmp_path):
    family = Cochlea(500)
    generate(family, family.grid(8), 6, tmp_path / "set.zarr", seed=3, shard=2, device="cpu")
    bring(tmp_path / "set.zarr", f"{base}/set.zarr")
    here, there = SDMDataset(tmp_path / "set.zarr"), SDMDataset(f"{base}/set.zarr")
    assert here.manifest == there.manifest
    assert torch.equal(here.theta, there.theta)
    batches = [next(iter(DataLoader(one, batch_size=6))) for one in (here, there, pickle.loads(pickle.dumps(there)))]
    assert all(torch.equal(batches[0].sdm, batch.sdm) for batch in batches)
    assert repr(there) == repr(here)
    # A file that is gone is no empty sample.
    files, path = fsspec.core.url_to_fs(f"{base}/set.zarr/sdm/c/1/0/0/0")
    files.rm(path)
    with pytest.raises(sdm.SDMError, match=r"sample 2 of .*set\.zarr is gone"):
        _ = SDMDataset(f"{base}/set.zarr")[2]


def test_what_is_not_there(base):
    with pytest.raises(MeshError, match=rf"there is no file {base}/none\.ply"):
        sdm.load_mesh(f"{base}/none.ply")
    with pytest.raises(FormatError, match=rf"there is no file {base}/none\.npz"):
        sdm.load(f"{base}/none.npz")
    with pytest.raises(FormatError, match=rf"{base}/none is not a dataset"):
        SDMDataset(f"{base}/none")


def test_sentences_name_the_address(base, tmp_path):
    (tmp_path / "bad.ply").write_bytes(b"ply\nno")
    bring(tmp_path / "bad.ply", f"{base}/bad.ply")
    with pytest.raises(MeshError, match=rf"^{base}/bad\.ply cannot be read"):
        sdm.load_mesh(f"{base}/bad.ply")
    with pytest.raises(FormatError, match=rf"^{base}/map\.png does not end like a map"):
        sdm.save(sdm.signed_distance_map(trimesh.creation.icosphere(1), 4, device="cpu"), f"{base}/map.png")


def test_protocols_that_nobody_can_open(monkeypatch):
    with pytest.raises(MeshError, match=r"nonsense://a\.ply cannot be opened: .*nonsense"):
        sdm.load_mesh("nonsense://a.ply")

    def missing(address: str) -> None:
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fsspec.core, "url_to_fs", missing)
    with pytest.raises(FormatError, match=r"s3://a/b\.zarr cannot be opened: Install s3fs .*extra remote"):
        SDMDataset("s3://a/b.zarr")


def test_a_server_that_refuses(monkeypatch):
    class Refusing:
        def isdir(self, path: str) -> bool:
            raise RuntimeError("no credentials\nat all")

    monkeypatch.setattr(remote, "file_system", lambda address: (Refusing(), "a.npz"))
    with pytest.raises(FormatError, match=r"memory://a\.npz cannot be read or written: no credentials"):
        sdm.load("memory://a.npz")
