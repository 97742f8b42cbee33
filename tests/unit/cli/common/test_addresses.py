"""Commands that read and write at addresses: in memory, on a server of S3's protocol, of a web server."""

from __future__ import annotations

import json
import tempfile
import threading
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli.app import main
from sdm.dataset import SDMDataset, shard_stage
from sdm.io.files import stand_in

# Sessions of s3fs are closed when they like.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

fsspec = pytest.importorskip("fsspec", reason="needs fsspec, of the extra remote")


@contextmanager
def in_memory(monkeypatch):
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    yield "memory://bucket"
    memory.store.clear()


@contextmanager
def on_s3(monkeypatch):
    """A server of S3's protocol on this machine, moto's."""
    pytest.importorskip("s3fs", reason="needs s3fs, fsspec's package for s3")
    moto = pytest.importorskip("moto.server", reason="needs moto[server]")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    known = {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}
    for name, value in {**known, "ENDPOINT_URL": f"http://{host}:{port}"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    fsspec.filesystem("s3").clear_instance_cache()
    # The server keeps those of tests before.
    bucket = f"bucket-{uuid4()}"
    fsspec.filesystem("s3").mkdir(bucket)
    yield f"s3://{bucket}"
    server.stop()


@pytest.fixture(params=[in_memory, on_s3])
def base(request, tmp_path, monkeypatch):
    """The address of an object store with a folder of meshes."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    meshes = write_meshes(tmp_path / "meshes")
    with request.param(monkeypatch) as address:
        files, path = opened(f"{address}/meshes")
        files.put(str(meshes), path, recursive=True)
        yield address
    # Nothing is left here.
    assert not stand_in.known()
    # Warp keeps a folder of headers while it compiles.
    assert not [path for path in (tmp_path / "temporary").iterdir() if not path.name.startswith("wp_pch_")]


def opened(address: str) -> tuple[Any, str]:
    files, path = fsspec.core.url_to_fs(address)
    files.invalidate_cache()
    return files, path


def write_meshes(folder: Path) -> Path:
    for number in range(3):
        place = folder / f"class{number % 2}" / f"{number}" / "model.ply"
        place.parent.mkdir(parents=True)
        trimesh.creation.icosphere(2, radius=1 + number).export(place)
    (folder / "class0" / "notes.txt").write_text("no mesh")
    return folder


def there(address: str) -> dict[str, bytes]:
    """Files below an address by their names."""
    files, path = opened(address)
    return {name.removeprefix(path).lstrip("/"): files.cat_file(name) for name in files.find(path)}


def here(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_compute_writes_what_it_would_write_here(base, tmp_path, capsys):
    words = ["--resolution", "8", "--format", "npz", "--device", "cpu"]
    assert main(["compute", str(tmp_path / "meshes"), "-o", str(tmp_path / "maps"), *words]) == 0
    assert main(["compute", f"{base}/meshes", "-o", f"{base}/maps", *words, "--report", f"{base}/told.json"]) == 0
    assert there(f"{base}/maps") == here(tmp_path / "maps")
    files, bucket = opened(base)
    told = json.loads(files.cat_file(f"{bucket}/told.json"))
    assert told["meshes"][0]["mesh"] == f"{base}/meshes/class0/0/model.ply"
    assert told["meshes"][0]["output"] == f"{base}/maps/class0/0/model.npz"
    assert f"written to {base}/maps/class0/0/model.npz" in capsys.readouterr().out
    # Nothing is done twice, and a map of another mesh is made anew.
    files.cp_file(f"{bucket}/maps/class0/0/model.npz", f"{bucket}/maps/class1/1/model.npz")
    files.rm(f"{bucket}/maps/class0/2/model.npz")
    assert main(["compute", f"{base}/meshes", "-o", f"{base}/maps", *words, "--resume"]) == 0
    assert capsys.readouterr().out.count("is there already") == 1
    assert there(f"{base}/maps") == here(tmp_path / "maps")


@pytest.mark.parametrize("ending", ["nii.gz", "zarr"])
def test_one_map(base, ending, tmp_path):
    for _ in range(2):
        words = ["--resolution", "8", "--device", "cpu"]
        assert main(["compute", f"{base}/meshes/class1/1/model.ply", "-o", f"{base}/new/map.{ending}", *words]) == 0
    expected = sdm.signed_distance_map(tmp_path / "meshes/class1/1/model.ply", 8, device="cpu")
    assert torch.equal(sdm.load(f"{base}/new/map.{ending}").values, expected.values)


def test_a_bad_mesh_is_named_by_its_address(base, capsys):
    files, bucket = opened(base)
    files.pipe_file(f"{bucket}/meshes/class0/bad.ply", b"ply\n")
    words = ["compute", f"{base}/meshes", f"--out={base}/maps", "--resolution", "8", "--format", "npz", "--device=cpu"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert f"{base}/meshes/class0/bad.ply cannot be read" in said
    assert "/temporary" not in said
    assert len(there(f"{base}/maps")) == 3


def test_generate_and_its_resumption(base, tmp_path, monkeypatch):
    words = ["generate", "cochlea", "--triangles", "500", "--resolution", "8", "--count", "6", "--shard", "2"]
    words += ["--device", "cpu"]
    assert main([*words, "-o", str(tmp_path / "set.zarr")]) == 0
    written = shard_stage.write_shard

    def dies(*given):
        if given[2] == 2:
            raise KeyboardInterrupt
        written(*given)

    monkeypatch.setattr(shard_stage, "write_shard", dies)
    assert main([*words, "-o", f"{base}/set.zarr"]) == 130
    assert not there(f"{base}/set.zarr")
    assert there(f"{base}/set.zarr.part")
    made = []
    monkeypatch.setattr(shard_stage, "write_shard", lambda *given: (made.append(given[2]), written(*given)))
    assert main(["generate", "-o", f"{base}/set.zarr", "--resume", "--device", "cpu"]) == 0
    assert 0 not in made
    assert there(f"{base}/set.zarr") == here(tmp_path / "set.zarr")
    assert not there(f"{base}/set.zarr.part")
    assert torch.equal(SDMDataset(f"{base}/set.zarr")[5].sdm, SDMDataset(tmp_path / "set.zarr")[5].sdm)


def test_generate_from_a_folder_at_an_address(base, tmp_path):
    words = ["--resolution", "8", "--count", "4", "--device", "cpu"]
    assert main(["generate", f"{base}/meshes", "-o", str(tmp_path / "one.zarr"), *words]) == 0
    assert main(["generate", str(tmp_path / "meshes"), "-o", str(tmp_path / "other.zarr"), *words]) == 0
    one, other = (SDMDataset(tmp_path / name) for name in ("one.zarr", "other.zarr"))
    assert all(torch.equal(one[n].sdm, other[n].sdm) for n in range(4))
    assert one.manifest["source"]["folder"] == f"{base}/meshes"


@pytest.mark.parametrize("layout", ["deepsdf", "occupancy", "zarr", "webdataset"])
def test_sample(base, layout, tmp_path):
    words = ["--layout", layout, "--count", "200", "--device", "cpu", "--dataset", "d"]
    assert main(["sample", str(tmp_path / "meshes"), "-o", str(tmp_path / "samples"), *words]) == 0
    assert main(["sample", f"{base}/meshes", "-o", f"{base}/samples", *words]) == 0
    expected, found = here(tmp_path / "samples"), there(f"{base}/samples")
    assert found.keys() == expected.keys()
    differ = {name for name in found if found[name] != expected[name]}
    assert differ <= {"report.json"}
    assert main(["sample", f"{base}/meshes", "-o", f"{base}/samples", *words]) == 2
    assert main(["sample", f"{base}/meshes", "-o", f"{base}/samples", *words, "--resume"]) == 0
    again = there(f"{base}/samples")
    assert {name for name in again if again[name] != expected[name]} <= {"report.json"}


def test_watertight(base, capsys):
    words = ["watertight", f"{base}/meshes", "-o", f"{base}/closed", "--resolution", "16", "--device", "cpu"]
    assert main(words) == 0
    assert len([name for name in there(f"{base}/closed") if name.endswith(".ply")]) == 3
    assert "unfinished.jsonl" not in there(f"{base}/closed")
    capsys.readouterr()
    assert main([*words, "--resume"]) == 0
    assert capsys.readouterr().out.count("is there already") == 3


def test_surface(base, tmp_path):
    words = ["--resolution", "16", "--device", "cpu"]
    assert main(["compute", f"{base}/meshes", "-o", f"{base}/maps", *words]) == 0
    assert main(["compute", str(tmp_path / "meshes"), "-o", str(tmp_path / "maps"), *words]) == 0
    assert main(["surface", f"{base}/maps", "-o", f"{base}/surfaces", "--device", "cpu"]) == 0
    assert main(["surface", str(tmp_path / "maps"), "-o", str(tmp_path / "surfaces"), "--device", "cpu"]) == 0
    assert there(f"{base}/surfaces") == here(tmp_path / "surfaces")


def test_what_is_refused(base, capsys):
    assert main(["view", f"{base}/meshes/class1/1/model.ply", "-o", "x.png"]) == 2
    assert f"copy {base}/meshes/class1/1/model.ply here first" in capsys.readouterr().err
    assert main(["compute", f"{base}/gone.ply", "-o", f"{base}/maps/x.npz"]) == 2
    assert f"there is no file {base}/gone.ply" in capsys.readouterr().err
    assert main(["compute", "nosuch://a/b.ply", "-o", "x.npz"]) == 2
    assert "nosuch" in capsys.readouterr().err
    assert main(["generate", "cochlea", "--count", "2", "-o", f"{base}/set.zarr", "--verify"]) == 2
    assert "--verify" in capsys.readouterr().err


def test_meshes_of_a_web_server(tmp_path, monkeypatch):
    pytest.importorskip("aiohttp", reason="needs aiohttp, fsspec's package for http")
    folder = write_meshes(tmp_path / "meshes")
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    monkeypatch.setattr(SimpleHTTPRequestHandler, "log_message", lambda *_: None)
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        address = f"http://127.0.0.1:{server.server_port}/class1/1/model.ply"
        assert main(["compute", address, "-o", str(tmp_path / "map.npz"), "--resolution", "8", "--device", "cpu"]) == 0
    finally:
        server.shutdown()
        server.server_close()
    expected = sdm.signed_distance_map(folder / "class1/1/model.ply", 8, device="cpu")
    assert np.array_equal(sdm.load(tmp_path / "map.npz").numpy(), expected.numpy())
