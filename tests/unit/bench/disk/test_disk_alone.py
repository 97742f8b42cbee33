"""The plain writer and the rates beside which `sdm generate` and `sdm compute` are held on a disk."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from sdm.bench.disk import plain_writer
from sdm.bench.disk.devices import compute_rows, generate_rows
from sdm.bench.disk.pairs import row_of as pairs_of
from sdm.bench.disk.plain_writer import plain_seconds
from sdm.bench.disk.real_disk import WORKS, row_of, works
from sdm.bench.disk.steady import bytes_in, rates
from sdm.runtime.file_space import take_space
from sdm.runtime.pipeline.stage_times import StageTimes


@pytest.mark.parametrize("direct", [False, True])
def test_the_plain_writer_writes_what_it_is_asked_for(tmp_path, monkeypatch, direct):
    sizes, found = [0, 1, 4096, 5 << 20], []
    monkeypatch.setattr(plain_writer.shutil, "rmtree", lambda folder: found.extend(sizes_in(folder)))
    try:
        assert plain_seconds(tmp_path / "plain", sizes, threads=2, direct=direct) > 0
    except OSError:
        if not direct:
            raise
        pytest.skip("the file system has no way past the cache")
    assert sorted(found) == sizes


def sizes_in(folder: Path) -> list[int]:
    return [file.stat().st_size for file in folder.iterdir()]


def test_rates_leave_the_start_out():
    # Ten seconds until anything is done, then one a second; all in steps of ten.
    found = rates(0.0, [10.0 + 10 * step for step in range(1, 11)], [10 * step for step in range(1, 11)])
    assert found == {"of_all": round(100 / 110, 1), "steady": 1.0}
    assert rates(0.0, [2.0], [4]) == {"of_all": 2.0}


def test_space_that_is_taken_is_not_written_yet(tmp_path):
    (tmp_path / "some").mkdir()
    (tmp_path / "some" / "small").write_bytes(bytes(100))
    with (tmp_path / "large").open("wb", buffering=0) as file:
        if not take_space(file.fileno(), 1 << 22):
            pytest.skip("the file system takes no space beforehand")
        for _ in range(3):
            file.write(bytes(1 << 16))
        os.fsync(file.fileno())
        assert bytes_in(tmp_path) == 100 + 3 * (1 << 16)
        file.truncate(1 << 16)
    assert bytes_in(tmp_path) == 100 + (1 << 16)


def test_a_row_of_each_work(tmp_path, monkeypatch, capsys):
    for name, value in (("TRIANGLES", 500), ("MAPS_AT", 8), ("MESHES_AT", 8)):
        monkeypatch.setattr(f"sdm.bench.disk.real_disk.{name}", value)
    names = [WORKS[3], WORKS[0], WORKS[2], WORKS[1]]
    found = [row_of(work, tmp_path, 1, 0.0, "cpu", 1, 10**6) for work in works(names, tmp_path, 2, 3, "cpu", 1)]
    assert [row["work"] for row in found] == names
    assert all(row["of_smaller"] > 0 and row["of_one_after_the_other"] >= row["of_smaller"] for row in found)
    assert not (tmp_path / "out").exists()


def test_a_command_is_measured_to_its_exit(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sdm.bench.disk.real_disk.TRIANGLES", 500)
    monkeypatch.setattr("sdm.bench.disk.real_disk.MESHES_AT", 8)
    (work,) = works([WORKS[3]], tmp_path, 2, 3, "cpu", 0)
    (tmp_path / "out").mkdir()
    times = StageTimes()
    found = work.run(tmp_path / "out", times)
    # The start of Python counts, which no three such meshes take.
    assert 0 < found["of_all"] < 30
    assert len(list((tmp_path / "out").glob("*.nii.gz"))) == 3
    assert min(times.seconds[stage] for stage in ("read", "cpu", "write")) > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["meshes", "out"]


def test_ways_to_share_and_pairs(tmp_path, monkeypatch, capsys):
    for name, value in (("TRIANGLES", 500), ("MAPS_AT", 8), ("MESHES_AT", 8)):
        monkeypatch.setattr(f"sdm.bench.disk.devices.{name}", value)
    assert [row["processes"] for row in generate_rows(tmp_path, 2, [["cpu"]], torch.float16, "none")] == [["cpu"]]
    assert [row["count"] for row in compute_rows(tmp_path, 3, [["cpu"], ["cpu"]], 2)] == [3, 3]
    monkeypatch.setattr("sdm.bench.disk.pairs.TRIANGLES", 500)
    monkeypatch.setattr("sdm.bench.disk.pairs.MAPS_AT", 8)
    row = pairs_of(tmp_path, 2, 2, torch.float16, "none")
    assert len(row["of_engine_all"]) == 2
    assert min(row["of_engine_all"]) <= row["of_engine"] <= max(row["of_engine_all"])
