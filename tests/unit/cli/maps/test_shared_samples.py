"""`sdm sample` by several workers: the same bytes as by one, also where several meshes lie in one file."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from sdm.cli.maps.sample_run import SampleOptions, run
from sdm.runtime.sharing import share_out

COUNT, MESHES = 200, 21


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "in"
    place.mkdir()
    for number in range(MESHES):
        ball = trimesh.creation.icosphere(1)
        ball.apply_scale([1, 1 + 0.1 * number, 1])
        ball.export(place / f"{number:02}.ply")
    (place / "05.ply").write_bytes(b"ply\n")
    return place


def sampled(folder: Path, out: Path, layout: str, **more) -> dict[str, bytes]:
    options = SampleOptions(
        law=None, shares=(None, None, None), deviations=None, box=None, normalize=None, count=COUNT, closest=False,
        sign="winding", hole_size=None, open_meshes="keep", seed=5,
    )  # fmt: skip
    assert run([folder], out, layout, options, device="cpu", skip_bad=True, **more) is None
    found = {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    del found["report.json"]
    return found


@pytest.mark.parametrize("layout", ["deepsdf", "occupancy", "zarr", "webdataset"])
def test_workers_share_the_meshes(layout, folder, tmp_path, monkeypatch):
    # Tar files of three meshes.
    monkeypatch.setattr("sdm.sampling.layouts.webdataset.SHARD_BYTES", 16 * COUNT * 3)
    monkeypatch.setattr("sdm.cli.maps.sample_run.processes_for", lambda devices, *_, **__: devices)
    shared = []

    def by_turns(job, shards, devices, done, **_):
        shared.append((len(shards), job.each))
        makers = [job.maker(device) for device in devices]
        # As processes would that end in another order.
        for place in reversed(range(len(devices))):
            job.run(shards[place :: len(devices)], makers[place], done)

    monkeypatch.setattr(share_out, "run_here", by_turns)
    alone = sampled(folder, tmp_path / "one", layout)
    assert not shared
    assert sampled(folder, tmp_path / "two", layout, devices=["cpu", "cpu"]) == alone
    assert shared == [(3, 9 if layout == "webdataset" else 8)]
