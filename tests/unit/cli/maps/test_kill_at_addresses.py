"""Kill -9 of commands that write to an object store: what is there is whole, and a restart does the rest."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest
import trimesh

from sdm.cli import main
from tests.helpers.processes.killed_command import CHILD

# Sessions of s3fs are closed when they like.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
MESHES = 30


@pytest.fixture(scope="module")
def server() -> Iterator[None]:
    """A server of S3's protocol on this machine, moto's."""
    pytest.importorskip("s3fs", reason="needs s3fs, fsspec's package for s3")
    moto = pytest.importorskip("moto.server", reason="needs moto[server]")
    started = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    started.start()
    host, port = started.get_host_and_port()
    known = {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**known, "ENDPOINT_URL": f"http://{host}:{port}"}.items():
            patch.setenv(f"AWS_{name}", value)
        yield
    started.stop()


@pytest.fixture
def bucket(server) -> str:
    import fsspec

    fsspec.filesystem("s3").clear_instance_cache()
    name = f"bucket-{uuid4()}"
    fsspec.filesystem("s3").mkdir(name)
    return f"s3://{name}"


@pytest.fixture
def meshes(tmp_path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    for number in range(MESHES):
        trimesh.creation.icosphere(2, radius=1 + number).export(folder / f"{number:02}.ply")
    return folder


def there(address: str) -> dict[str, bytes]:
    """Files below an address by their names."""
    import fsspec

    files, path = fsspec.core.url_to_fs(address)
    files.invalidate_cache()
    # What is gone when it is its turn was moved.
    found = files.cat(files.find(path), on_error="omit") if files.exists(path) else {}
    return {name.removeprefix(path).lstrip("/"): content for name, content in found.items()}


def here(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def kill(words: list[str], address: str, ending: str, count: int, temporary: Path) -> None:
    """Run a command, and kill it once so many files that end so are at an address."""
    import fsspec

    temporary.mkdir(exist_ok=True)
    child = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", CHILD, *words],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    files, path = fsspec.core.url_to_fs(address)
    deadline = time.monotonic() + 90
    while True:
        files.invalidate_cache()
        if files.exists(path) and sum(name.endswith(ending) for name in files.find(path)) >= count:
            break
        assert time.monotonic() < deadline
        assert child.poll() is None
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    # Hollow files of a killed process.
    shutil.rmtree(temporary)


# Files that tell of the run besides: times, and paths of this machine.
TOLD = ("report.json", "unfinished.jsonl")
COMMANDS = {
    "compute": (["--resolution", "40", "--format", "npz"], ".npz", 8),
    "sample": (["--count", "20000", "--dataset", "d"], ".npz", 12),
    "watertight": (["--resolution", "24"], ".ply", 4),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder(command, meshes, bucket, tmp_path, capsys):
    more, ending, count = COMMANDS[command]
    words = [command, str(meshes), "--device", "cpu", *more, "-o"]
    assert main([*words, str(tmp_path / "here")]) == 0
    expected = {name: content for name, content in here(tmp_path / "here").items() if name not in TOLD}
    kill([*words, f"{bucket}/out"], f"{bucket}/out", ending, count, tmp_path / "temporary")
    cut = {name: content for name, content in there(f"{bucket}/out").items() if name not in TOLD}
    # Not one half, and not all.
    assert cut.items() <= expected.items()
    assert count <= len([name for name in cut if name.endswith(ending)])
    assert len(cut) < len(expected)
    capsys.readouterr()
    assert main([*words, f"{bucket}/out", "--resume"]) == 0
    if command != "sample":
        old = capsys.readouterr().out.count("is there already")
        # Of closed surfaces those in flight may have been written, and not yet told.
        assert len(cut) - (2 if command == "watertight" else 0) <= old <= len(cut)
    found = there(f"{bucket}/out")
    assert {name: content for name, content in found.items() if name not in TOLD} == expected
    assert "unfinished.jsonl" not in found


@pytest.mark.slow
def test_a_dataset(bucket, tmp_path):
    """In the middle of its shards, and of the way to its name."""
    words = ["generate", "cochlea", "--triangles", "500", "--resolution", "24", "--count", "60", "--shard", "2"]
    words += ["--device", "cpu", "-o"]
    assert main([*words, str(tmp_path / "set.zarr")]) == 0
    expected, address = here(tmp_path / "set.zarr"), f"{bucket}/set.zarr"
    kill([*words, address], f"{address}.part/sha256/c", "/0", 3, tmp_path / "temporary")
    cut = there(f"{address}.part")
    assert cut.items() <= expected.items()
    assert not there(address)
    kill(["generate", "--resume", "--device", "cpu", "-o", address], address, "/0", 5, tmp_path / "temporary")
    moved = there(address)
    assert moved.items() <= expected.items()
    assert main(["generate", "--resume", "--device", "cpu", "-o", address]) == 0
    assert there(address) == expected
    assert not there(f"{address}.part")


@pytest.mark.parametrize("whole", [False, True])
def test_a_move_that_was_cut_off(whole, bucket, tmp_path):
    words = ["generate", "cochlea", "--triangles", "500", "--resolution", "8", "--count", "4", "--shard", "2"]
    words += ["--device", "cpu", "-o"]
    assert main([*words, f"{bucket}/set.zarr"]) == 0
    expected = there(f"{bucket}/set.zarr")
    import fsspec

    files, path = fsspec.core.url_to_fs(f"{bucket}/set.zarr")
    # Copied in part, and then copied whole and removed in part.
    for name, content in expected.items():
        files.pipe_file(f"{path}.part/{name}", content)
    files.rm(f"{path}.part/zarr.json" if whole else f"{path}/zarr.json")
    files.rm(f"{path}.part/theta/c/0/0" if whole else f"{path}/theta/c/0/0")
    assert main(["generate", "--resume", "--device", "cpu", "-o", f"{bucket}/set.zarr"]) == 0
    assert there(f"{bucket}/set.zarr") == expected
    assert not there(f"{bucket}/set.zarr.part")


def test_a_restart_goes_by_the_manifest(meshes, bucket, tmp_path, monkeypatch, capsys):
    from sdm.cli.maps import line_file
    from sdm.cli.maps.map_stages import MapStages

    monkeypatch.setattr(line_file, "SECONDS", 0.0)
    import fsspec

    fsspec.filesystem("s3").put(str(meshes), f"{bucket}/meshes", recursive=True)
    words = ["compute", f"{bucket}/meshes", "--resolution", "6", "--format", "npz", "--device", "cpu"]
    words += ["-o", f"{bucket}/out"]
    read, seen = MapStages.read, []

    def noted(self, task):
        seen.append(task.name)
        if len(seen) == 20:
            raise KeyboardInterrupt
        return read(self, task)

    monkeypatch.setattr(MapStages, "read", noted)
    assert main(words) == 130
    known = there(f"{bucket}/out")["unfinished.jsonl"].count(b'"target"')
    assert known >= 10
    seen.clear()
    # Two that were touched since: a mesh, and a map, whose size is the same.
    time.sleep(2.1)
    files = fsspec.filesystem("s3")
    for name in ("meshes/00.ply", "out/01.npz"):
        files.pipe_file(f"{bucket}/{name}", files.cat_file(f"{bucket}/{name}"))
    monkeypatch.setattr(MapStages, "read", lambda self, task: (seen.append(task.name), read(self, task))[1])
    capsys.readouterr()
    assert main([*words, "--resume"]) == 0
    assert len(seen) == MESHES - known + 2
    assert {"00.ply", "01.ply"} <= set(seen)
    assert "unfinished.jsonl" not in there(f"{bucket}/out")
