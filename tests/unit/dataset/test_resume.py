"""Cut off at any moment, a dataset is finished to the same bytes; damaged shards are found and made again."""

from __future__ import annotations

import errno
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import time
from functools import cache
from pathlib import Path

import pytest
import torch
import zarr

from sdm.core.demo_mesh import demo_mesh
from sdm.core.grid import Grid
from sdm.dataset import SDMDataset, damaged, generate, layout, shard_stage, shard_writer, verify
from sdm.dataset.manifest import read_manifest
from sdm.dataset.repair import mend_arrays
from sdm.dataset.shard_paths import file_of
from sdm.errors import FormatError, SDMError
from sdm.io.files.lock import alone
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.shapes import Cochlea, MeshFolder
from tests.helpers import generate_command

FAMILY = Cochlea(600)
COUNT = 11


@cache
def grid() -> Grid:
    return FAMILY.grid(10)


def write(path, **options):
    return generate(FAMILY, grid(), options.pop("count", COUNT), path, **{"device": "cpu", "shard": 3, **options})


def contents(folder: Path) -> dict[str, str]:
    files = (f for f in folder.rglob("*") if f.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("whole") / "d.zarr")


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    return shutil.copytree(whole, tmp_path / "d.zarr")


class Stop(Exception):
    pass


@pytest.mark.parametrize("after", [0, 1, 2, 3])
def test_a_stopped_one_is_finished_to_the_same_bytes(whole, tmp_path, monkeypatch, after):
    target = tmp_path / "d.zarr"
    count = 0

    def fail(*args, **kwargs):
        nonlocal count
        count += 1
        if count > after:
            raise Stop
        shard_writer.write_shard(*args, **kwargs)

    monkeypatch.setattr(shard_stage, "write_shard", fail)
    with pytest.raises(Stop):
        write(target)
    assert not target.exists()
    with pytest.raises(FormatError, match="unfinished dataset: --resume"):
        write(target)
    with pytest.raises(FormatError, match="not finished"):
        SDMDataset(target)
    monkeypatch.undo()
    seen = []
    write(target, resume=True, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (min(COUNT, 3 * after), COUNT)
    assert seen[-1] == (COUNT, COUNT)
    assert contents(target) == contents(whole)
    assert not layout.part_of(target).exists()


def test_a_dataset_of_version_2_is_finished_in_its_own_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr("sdm.dataset.writer.VERSION", 2)
    # A map of more than one block.
    options = {"grid": FAMILY.grid(24), "count": 4}
    old = generate(FAMILY, path=tmp_path / "d.zarr", device="cpu", shard=2, **options)
    before = contents(old)
    monkeypatch.undo()
    now = generate(FAMILY, path=tmp_path / "now.zarr", device="cpu", shard=2, **options)
    file = file_of(Path("."), "sdm", 1)
    assert (now / file).stat().st_size < (old / file).stat().st_size
    old.rename(layout.part_of(old))
    (layout.part_of(old) / file).unlink()
    assert mend_arrays(layout.part_of(old)) == []
    generate(FAMILY, path=old, device="cpu", shard=2, resume=True, **options)
    assert contents(old) == before
    assert torch.equal(SDMDataset(old)[3].sdm, SDMDataset(now)[3].sdm)


def test_a_full_disk_is_said_and_loses_one_shard(whole, tmp_path, monkeypatch):
    target = tmp_path / "d.zarr"
    real, calls = shard_writer.put, []

    def full(path, content):
        calls.append(path)
        if len(calls) == 6:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(path, content)

    monkeypatch.setattr(shard_writer, "put", full)
    with pytest.raises(FormatError, match="No space left on device; --resume"):
        write(target)
    monkeypatch.undo()
    part = layout.part_of(target)
    manifest = read_manifest(part)
    assert [layout.is_done(part, manifest, n) for n in range(4)] == [True, False, False, False]
    assert not list(part.rglob("*.part"))
    write(target, resume=True)
    assert contents(target) == contents(whole)


@pytest.mark.slow
@pytest.mark.parametrize("way", generate_command.WAYS)
def test_kill_9_at_any_moment_loses_only_what_is_in_flight(tmp_path, way):
    options = ["--count", "40", "--resolution", "24", "--triangles", "600", "--shard", "2", "--device", "cpu"]
    command = [*generate_command.words(way), "cochlea", *options, "-o"]
    expected = tmp_path / "expected.zarr"
    subprocess.run([*command, str(expected)], check=True, capture_output=True)
    target = tmp_path / "d.zarr"
    part = layout.part_of(target)
    kills = 0
    while not target.exists() and kills < 2:
        have = len(list(part.glob("sha256/c/*/0")))
        child = subprocess.Popen([*command, str(target), "--resume"], stderr=subprocess.DEVNULL)
        limit = time.monotonic() + 60
        while child.poll() is None and time.monotonic() < limit and len(list(part.glob("sha256/c/*/0"))) < have + 3:
            time.sleep(0.005)
        if child.poll() is None:
            child.send_signal(signal.SIGKILL)
            kills += 1
        child.wait()
        assert len(list(part.glob("sha256/c/*/0"))) >= have + 3 or target.exists()
    assert kills
    # Neither family nor options are needed: the dataset knows.
    subprocess.run([*generate_command.words(way), "--resume", "-o", str(target)], check=True, capture_output=True)
    assert contents(target) == contents(expected)


@pytest.mark.parametrize(
    "harm",
    [
        lambda d: (d / "sdm/c/1/0/0/0").write_bytes((d / "sdm/c/1/0/0/0").read_bytes()[:-5]),
        lambda d: (d / "sdm/c/1/0/0/0").unlink(),
        lambda d: (d / "theta/c/1/0").write_bytes(bytes(48)),
        lambda d: (d / "sha256/c/1/0").unlink(),
        lambda d: (d / "sha256/c/1/0").write_bytes(bytes(32)),
    ],
    ids=["cut", "gone", "theta", "no checksum", "wrong checksum"],
)
def test_damage_is_found_and_mended(whole, copy, harm):
    assert damaged(copy) == []
    assert verify(copy, FAMILY, device="cpu") == []
    harm(copy)
    assert damaged(copy) == [1]
    assert verify(copy, FAMILY, device="cpu") == [1]
    assert contents(copy) == contents(whole)


@pytest.mark.parametrize(
    "harm",
    [
        lambda file: file.unlink(),
        lambda file: file.write_bytes(b"{"),
        lambda file: file.write_text(file.read_text().replace("11", "12")),
        lambda file: file.write_text(file.read_text().replace('"crc32c"', '"crc"')),
        lambda file: shutil.rmtree(file.parent / "c"),
    ],
    ids=["gone", "cut", "rows", "codec", "shards"],
)
@pytest.mark.parametrize("name", ["sdm", "theta", "sha256"])
def test_damaged_descriptions_of_arrays_are_mended(whole, copy, name, harm):
    harm(copy / name / "zarr.json")
    verify(copy, FAMILY, device="cpu")
    assert contents(copy) == contents(whole)
    assert len(SDMDataset(copy)) == COUNT


def test_a_sound_dataset_is_left_as_it_is(copy):
    assert mend_arrays(copy) == []
    zarr.open_array(copy / "theta").attrs["note"] = "mine"
    assert mend_arrays(copy) == []
    # As another version of Zarr may write it.
    file = copy / "sdm/zarr.json"
    file.write_text(json.dumps({k: v for k, v in json.loads(file.read_text()).items() if k != "storage_transformers"}))
    assert mend_arrays(copy) == []


def test_one_flipped_bit_is_an_error_when_it_is_read(copy):
    path = copy / "sdm/c/1/0/0/0"
    content = bytearray(path.read_bytes())
    content[100] ^= 1
    path.write_bytes(content)
    data = SDMDataset(copy)
    with pytest.raises(SDMError, match=r"sample 3 of .* is damaged: sdm generate --verify"):
        data[3]
    path.unlink()
    with pytest.raises(SDMError, match="is gone: sdm generate --verify"):
        SDMDataset(copy)[3]
    assert torch.isfinite(data[0].sdm).all()


def test_lost_parameters_are_never_zeros(copy):
    path = copy / "theta/c/1/0"
    whole = path.read_bytes()
    for content in (whole[:-4], b""):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=r"theta of .* is damaged: sdm generate --verify"):
            SDMDataset(copy)
    path.unlink()
    with pytest.raises(FormatError, match=r"theta of shard 1 of .* is gone: sdm generate --verify"):
        SDMDataset(copy)


def test_lost_poses_are_never_zeros(tmp_path):
    family = MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3)])
    data = SDMDataset(generate(family, family.grid(8), 3, tmp_path / "d.zarr", device="cpu", shard=2))
    assert torch.isfinite(data.inverse_transform(2)).all()
    path = data.path / "transform/c/1/0/0"
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(FormatError, match=r"transform of .* is damaged"):
        data.inverse_transform(2)
    path.unlink()
    with pytest.raises(FormatError, match=r"transform of shard 1 of .* is gone"):
        data.inverse_transform(2)
    assert torch.isfinite(data.inverse_transform(1)).all()


def test_another_recipe_is_not_mixed_in(whole, copy):
    with pytest.raises(FormatError, match="there already"):
        write(copy)
    assert write(copy, resume=True) == copy
    copy.rename(layout.part_of(copy))
    before = contents(layout.part_of(copy))
    for options, message in (
        ({"seed": 1}, "seed 0, but 1"),
        ({"count": 12}, "count 11, but 12"),
        ({"truncate": 1.0}, "truncate None, but 1.0"),
        ({"sampler": "sobol"}, "sampler uniform"),
    ):
        with pytest.raises(FormatError, match=message):
            write(copy, resume=True, **options)
    with pytest.raises(FormatError, match=r"cochlea is not what .* was begun from: other faces"):
        generate(Cochlea(900), grid(), COUNT, copy, device="cpu", resume=True)
    assert contents(layout.part_of(copy)) == before
    write(copy, resume=True)
    assert contents(copy) == contents(whole)


def test_another_family_does_not_mend(copy):
    (copy / "sdm/c/1/0/0/0").unlink()
    with pytest.raises(FormatError, match="the family it was made with"):
        verify(copy, Cochlea(900), device="cpu")


def test_another_sampler_does_not_mend(copy):
    (copy / "sdm/c/1/0/0/0").unlink()
    with pytest.raises(FormatError, match="the sampler it was made with was uniform, here it is sobol"):
        verify(copy, FAMILY, sampler="sobol", device="cpu")


def test_one_that_another_process_writes_is_left_alone(whole, copy):
    part = copy.rename(layout.part_of(copy))
    (part / "sdm/c/1/0/0/0").unlink()
    before = contents(part)
    with alone(part):
        # Without `resume` too: it is neither to be removed nor to be gone on with.
        for use in (lambda: write(copy), lambda: write(copy, resume=True), lambda: verify(part, FAMILY, device="cpu")):
            with pytest.raises(FormatError, match="being written by another process"):
                use()
    assert contents(part) == before
    write(copy, resume=True)
    assert contents(copy) == contents(whole)


def test_two_that_begin_at_once(whole, tmp_path, monkeypatch):
    target = tmp_path / "d.zarr"
    empty = layout._empty

    def meanwhile(fresh, manifest):
        monkeypatch.undo()
        layout.create(layout.part_of(target), manifest)
        empty(fresh, manifest)

    monkeypatch.setattr(layout, "_empty", meanwhile)
    with pytest.raises(FormatError, match="unfinished dataset: --resume"):
        write(target)
    assert [path.name for path in tmp_path.iterdir()] == ["d.zarr.part"]
    write(target, resume=True)
    assert contents(target) == contents(whole)


@pytest.mark.slow
def test_several_processes_share_the_work(whole, tmp_path):
    target, times = tmp_path / "d.zarr", StageTimes()
    write(target, processes=["cpu", "cpu"], times=times)
    assert contents(target) == contents(whole)
    # So that progress names the stage that the others wait for.
    assert times.limit() in ("cpu", "write")


@pytest.mark.slow
def test_a_killed_worker_is_said_and_loses_what_it_had(tmp_path):
    target = tmp_path / "d.zarr"
    killed = []

    def kill_one(done: int, total: int) -> None:
        if done and not killed:
            killed.append(multiprocessing.active_children()[0])
            killed[0].kill()

    with pytest.raises(SDMError, match=r"process on cpu died .*--resume"):
        write(target, count=3000, progress=kill_one, processes=["cpu", "cpu"])
    assert not multiprocessing.active_children()
    part = layout.part_of(target)
    manifest = read_manifest(part)
    have = [n for n in range(1000) if layout.is_done(part, manifest, n)]
    assert 0 < len(have) < 1000
    assert all(layout.is_sound(part, manifest, n) for n in have)
