"""CPU launches cover every index once, on any number of threads."""
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false, reportArgumentType=false

from __future__ import annotations

import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

import sdm.engine.acceleration  # noqa: F401 (starts Warp quietly)
from sdm.kernels import launch


@wp.kernel(enable_backward=False)
def _count(begin: int, hits: wp.array(dtype=wp.int32)):
    i = begin + wp.tid()
    hits[i] = hits[i] + 1


@pytest.mark.parametrize("threads", ["1", "2", "3", "16"])
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 5000, 100_003])
def test_every_index_once(monkeypatch, threads, count):
    monkeypatch.setenv("SDM_NUM_THREADS", threads)
    launch._pool.cache_clear()
    hits = wp.zeros(max(count, 1), dtype=wp.int32, device="cpu")
    launch.launch(_count, count, [hits], "cpu")
    launch._pool.cache_clear()
    assert (hits.numpy()[:count] == 1).all()
    assert hits.numpy()[count:].sum() == 0


def test_a_thread_that_works_beside_others_asks_no_pool(monkeypatch):
    monkeypatch.setenv("SDM_NUM_THREADS", "3")
    launch._pool.cache_clear()
    hits = wp.zeros(100_003, dtype=wp.int32, device="cpu")
    with launch.by_this_thread():
        launch.launch(_count, 100_003, [hits], "cpu")
        assert launch._pool.cache_info().currsize == 0
    assert (hits.numpy() == 1).all()
    launch.launch(_count, 100_003, [hits], "cpu")
    assert launch._pool.cache_info().currsize == 1
    launch._pool.cache_clear()
    assert (hits.numpy() == 2).all()


def test_whoever_asks_waits_for_no_thread_that_is_busy_elsewhere(monkeypatch):
    busy, done = threading.Event(), threading.Event()
    pool = ThreadPoolExecutor(1)
    pool.submit(lambda: (busy.set(), done.wait(30)))
    busy.wait(30)
    monkeypatch.setenv("SDM_NUM_THREADS", "4")
    monkeypatch.setattr(launch, "_pool", lambda process: pool)
    hits = wp.zeros(100_003, dtype=wp.int32, device="cpu")
    launch.launch(_count, 100_003, [hits], "cpu")
    assert not done.is_set()
    done.set()
    pool.shutdown()
    assert (hits.numpy() == 1).all()


def test_threads(monkeypatch):
    import os

    monkeypatch.setenv("SDM_NUM_THREADS", "3")
    assert launch.threads() == 3
    for nonsense in ("", "many", "-2"):
        monkeypatch.setenv("SDM_NUM_THREADS", nonsense)
        assert launch.threads() == len(os.sched_getaffinity(0))
    monkeypatch.setenv("SDM_NUM_THREADS", "0")
    assert launch.threads() == 1


def test_an_error_in_a_thread_is_raised(monkeypatch):
    monkeypatch.setenv("SDM_NUM_THREADS", "2")
    launch._pool.cache_clear()
    hits = wp.zeros(4, dtype=wp.float32, device="cpu")
    with pytest.raises(Exception, match="hits"):
        launch.launch(_count, 10_000, [hits], "cpu")
    launch._pool.cache_clear()


def test_results_do_not_hang_on_the_threads(monkeypatch):
    """Boxes are reduced and crossings are counted by many threads at once; no update may get lost."""
    import torch

    import sdm
    from sdm.bench.common.meshes import load_case

    case = load_case("torus-20000")
    # Every triangle thrice: many threads meet at every voxel.
    mesh = sdm.TriangleMesh(case.vertices, np.concatenate([case.faces] * 3))
    grid = sdm.Grid([-1, -1, -0.3], [0.25, 0.25, 0.1], [9, 9, 7])
    maps = []
    for threads in ("1", "8"):
        monkeypatch.setenv("SDM_NUM_THREADS", threads)
        for _ in range(4):
            launch._pool.cache_clear()
            maps.append(sdm.signed_distance_map(mesh, grid, device="cpu").values)
    launch._pool.cache_clear()
    assert all(torch.equal(values, maps[0]) for values in maps)


def test_an_interrupt_waits_for_the_threads_that_are_at_work(monkeypatch):
    """Otherwise they write to memory that the caller has let go of."""
    begun, ended, other = [], [], threading.Event()

    def run(kernel, count, inputs, device, block_dim):
        begun.append(inputs[0])
        if inputs[0] == 0:
            assert other.wait(10)
            raise KeyboardInterrupt
        other.set()
        time.sleep(0.1)
        ended.append(inputs[0])

    monkeypatch.setattr(launch, "run", run)
    monkeypatch.setattr(launch, "threads", lambda: 2)
    monkeypatch.setattr(launch, "_pool", lambda _: pool)
    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        try:
            launch.launch(_count, 64, [], "cpu", smallest=1)
        finally:
            assert sorted([0, *ended]) == sorted(begun)


def test_no_kernel_uses_tiles(root):
    """On a CPU Warp 1.19 keeps where they are in one variable of a module, which launches of several threads share."""
    assert not [path for path in (root / "kernels").rglob("*.py") if re.search(r"\bwp\.tile_", path.read_text())]
