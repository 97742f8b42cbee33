"""Datasets made on a GPU: what the stream yields there, by one GPU or all of them, finished to the same bits."""

from __future__ import annotations

import pytest
import torch

from sdm.core.grid import Grid
from sdm.dataset import SDMDataset, damaged, generate, shard_job, shard_stage, verify
from sdm.runtime.worker_processes.shared_memory import can_share
from sdm.shapes import Cochlea
from sdm.stream import SDMStream

pytestmark = pytest.mark.gpu

FAMILY = Cochlea(2_000)
COUNT = 40


@pytest.fixture(scope="module")
def grid() -> Grid:
    return FAMILY.grid(32)


def maps(path) -> torch.Tensor:
    data = SDMDataset(path)
    return torch.stack([data[i].sdm for i in range(len(data))])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_holds_what_the_stream_yields(grid, tmp_path, dtype):
    batch = next(iter(SDMStream(FAMILY, grid, COUNT, device="cuda", dtype=dtype, truncate=1.5)))
    path = generate(FAMILY, grid, COUNT, tmp_path / "d.zarr", shard=16, dtype=dtype, truncate=1.5, device="cuda")
    assert torch.equal(maps(path), batch.sdm.cpu())
    assert SDMDataset(path).manifest["device"] == torch.cuda.get_device_name()


@pytest.mark.skipif(not can_share(), reason="this system has no memory without a name")
@pytest.mark.parametrize(("dtype", "compression"), [(torch.float32, "zstd"), (torch.float16, "none")])
def test_shards_by_processes_have_the_same_bytes(grid, tmp_path, monkeypatch, dtype, compression):
    content = []
    for name in ("thread_writers", "process_writers"):
        way, more = getattr(shard_stage, name), {} if name == "thread_writers" else {"count": 2}
        monkeypatch.setattr(shard_job, "shard_writers", lambda *where, way=way, more=more, **_: way(*where, **more))
        out = tmp_path / f"{name}.zarr"
        generate(FAMILY, grid, 200, out, shard=8, dtype=dtype, compression=compression, device="cuda")
        content.append({file.relative_to(out): file.read_bytes() for file in out.rglob("*") if file.is_file()})
    assert len(content[0]) > 70
    assert content[0] == content[1]


def test_is_finished_and_mended_to_the_same_bits(grid, tmp_path, monkeypatch):
    whole = generate(FAMILY, grid, COUNT, tmp_path / "whole.zarr", shard=8, device="cuda")
    real = shard_stage.write_shard

    def stop_at_2(*args):
        if args[2] == 2:
            raise KeyboardInterrupt
        real(*args)

    monkeypatch.setattr(shard_stage, "write_shard", stop_at_2)
    with pytest.raises(KeyboardInterrupt):
        generate(FAMILY, grid, COUNT, tmp_path / "d.zarr", shard=8, device="cuda")
    monkeypatch.undo()
    path = generate(FAMILY, grid, COUNT, tmp_path / "d.zarr", shard=8, device="cuda", resume=True)
    (path / "sdm/c/3/0/0/0").unlink()
    assert damaged(path) == [3]
    assert verify(path, FAMILY, device="cuda") == [3]
    assert torch.equal(maps(path), maps(whole))


@pytest.mark.slow
def test_every_gpu_of_the_machine_shares_the_work(grid, tmp_path):
    if torch.cuda.device_count() < 2:
        pytest.skip("needs two GPUs")
    alone = generate(FAMILY, grid, COUNT, tmp_path / "alone.zarr", shard=2, device="cuda:0")
    shared = generate(FAMILY, grid, COUNT, tmp_path / "shared.zarr", shard=2)
    assert torch.equal(maps(shared), maps(alone))
