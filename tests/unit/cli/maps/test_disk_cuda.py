"""From disk to disk on a GPU: copies that nobody waits for, joint calls and samples are what single calls give."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli import main
from sdm.runtime.host_copy import HostCopy, HostRows, pinned
from sdm.runtime.worker_processes.shared_memory import can_share

pytestmark = pytest.mark.gpu


def test_copies_hold_what_was_there_when_they_were_asked_for():
    copies, rows = [], HostRows((64, 1 << 18), torch.float32, torch.device("cuda"))
    for number in range(64):
        values = torch.full((1 << 18,), float(number), device="cuda")
        copies.append(HostCopy(values, lambda host: host))
        rows.put(number, values[None])
        # Its memory is another tensor's at once.
        del values
        torch.full((1 << 18,), -1.0, device="cuda")
    for number, copy in enumerate(copies):
        assert (copy.wait() == number).all()
    np.testing.assert_array_equal(rows.wait(), np.arange(64, dtype=np.float32)[:, None].repeat(1 << 18, 1))


def test_memory_that_is_pinned_holds_what_comes():
    memory, device = np.zeros(1 << 20, np.uint8), torch.device("cuda")
    values = torch.arange(1 << 18, device=device).float()
    with pinned(memory, device):
        found = HostCopy(values, lambda host: host.clone(), memory=memory).wait()
    assert torch.equal(found, values.cpu())


@pytest.fixture
def folder(tmp_path):
    for number in range(21):
        ball = trimesh.creation.icosphere(2 + number % 3)
        ball.apply_scale([1, 1 + 0.1 * number, 2])
        (tmp_path / "in" / f"{number % 4}").mkdir(parents=True, exist_ok=True)
        ball.export(tmp_path / "in" / f"{number % 4}" / f"{number}.stl")
    (tmp_path / "in" / "bad.off").write_text("OFF\nthree\n")
    return tmp_path / "in"


@pytest.mark.parametrize(("ending", "writers"), [("npz", 0), ("nii.gz", 0), ("zarr", 0), ("npz", 2), ("nii.gz", 2)])
def test_a_folder_of_maps(ending, writers, folder, tmp_path, monkeypatch):
    if writers and not can_share():
        pytest.skip("this system has no memory without a name")
    monkeypatch.setattr("sdm.cli.maps.run.writing_processes", lambda *_: writers)
    # Fewer rooms than maps.
    monkeypatch.setattr("sdm.cli.maps.map_writers.MOST_BYTES", 9 * 4 * 32**3)
    out = tmp_path / "out"
    words = ["compute", folder, "-o", out, "--format", ending, "--resolution", "32", "--device", "cuda", "--skip-bad"]
    assert main([str(word) for word in words]) == 0
    for source in folder.rglob("*.stl"):
        expected = sdm.signed_distance_map(source, resolution=32, device="cuda")
        found = sdm.load((out / source.relative_to(folder)).with_suffix(f".{ending}"))
        np.testing.assert_array_equal(found.numpy(), expected.numpy())


def test_samples(folder, tmp_path):
    words = ["sample", folder, "-o", tmp_path / "out", "--count", "5000", "--device", "cuda", "--skip-bad"]
    assert main([str(word) for word in words]) == 0
    for source in folder.rglob("*.stl"):
        place = source.relative_to(folder).with_suffix("")
        expected = sdm.sampling.sample(source, 5000, name=place.as_posix(), device="cuda")
        found = np.load(next((tmp_path / "out" / "SdfSamples").rglob(f"{source.stem}.npz")))
        rows = torch.cat([expected.points, expected.distances[:, None]], 1).cpu().numpy()
        np.testing.assert_array_equal(found["neg"], rows[rows[:, 3] < 0])
        np.testing.assert_array_equal(found["pos"], rows[rows[:, 3] >= 0])
