"""Inference mode, no_grad, threads and forked processes: results are the same in all of them."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere, torus

VERTICES, FACES = torus(1024)
POINTS = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
GRID = sdm.Grid([-1] * 3, [0.125] * 3, [17] * 3)


@pytest.fixture(scope="module")
def expected():
    mesh = sdm.TriangleMesh(VERTICES, FACES)
    return sdm.signed_distance(mesh, POINTS, device="cpu"), sdm.signed_distance_map(mesh, GRID, device="cpu").values


def _both() -> tuple[torch.Tensor, torch.Tensor]:
    mesh = sdm.TriangleMesh(torch.tensor(VERTICES), torch.tensor(FACES))
    return sdm.signed_distance(mesh, POINTS, device="cpu"), sdm.signed_distance_map(mesh, GRID, device="cpu").values


@pytest.mark.parametrize("mode", [torch.inference_mode, torch.no_grad, torch.enable_grad])
def test_modes(expected, mode):
    with mode():
        found = _both()
        # The same faces a second time.
        again = _both()
    for a, b, c in zip(found, again, expected, strict=True):
        assert torch.equal(a, c)
        assert torch.equal(b, c)


def test_made_in_inference_mode_used_outside(expected):
    with torch.inference_mode():
        index = sdm.MeshIndex(sdm.TriangleMesh(torch.tensor(VERTICES), torch.tensor(FACES)), "cpu")
    assert torch.equal(index.signed_distance(POINTS), expected[0])
    index.update(VERTICES)
    assert torch.equal(index.signed_distance_map(GRID).values, expected[1])


def test_faces_changed_in_place():
    """Cached facts about faces are forgotten when the faces change."""
    vertices, faces = sphere(4)
    tensor = torch.tensor(faces)
    mesh = sdm.TriangleMesh(vertices, tensor)
    assert sdm.MeshIndex(mesh, "cpu").closed
    tensor[0] = tensor[1]
    assert not sdm.MeshIndex(mesh, "cpu").closed


def test_threads(expected):
    """Several threads of one process, each with its own meshes, all at once."""
    shapes = [torus(1024), sphere(8), sphere(12), torus(256)]

    def work(i: int) -> list[torch.Tensor]:
        mesh = sdm.TriangleMesh(*shapes[i % len(shapes)])
        index = sdm.MeshIndex(mesh, "cpu")
        return [index.signed_distance(POINTS), index.signed_distance_map(GRID).values, index.winding_number(POINTS)]

    alone = [work(i) for i in range(len(shapes))]
    with ThreadPoolExecutor(6) as pool:
        for i, found in enumerate(pool.map(work, range(24))):
            for a, b in zip(found, alone[i % len(shapes)], strict=True):
                assert torch.equal(a, b)


FIRST = """
import os
import threading
import sdm
import sdm.engine.api
from sdm.core.demo_mesh import demo_mesh

def first_calls():
    mesh = demo_mesh(rings=21, segments=12)
    grid = sdm.Grid.around(mesh, resolution=12)
    all_at_once = threading.Barrier(4)

    def work():
        all_at_once.wait()
        sdm.signed_distance_map(mesh, grid, device="cpu")

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

# Each turn in a process of its own that has all but the kernels.
for turn in range(3):
    child = os.fork()
    if child == 0:
        first_calls()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
"""


def test_the_first_calls_of_a_process_by_several_threads():
    """Warp would load a module twice, and take back the first while it runs: that was a crash in every second try."""
    done = subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process(expected):
    """Workers of a data loader are forks: the parent's threads are not there, and nobody waits for them."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        ok = False
        try:
            # As a data loader's worker does: torch's own threads do not survive a fork.
            torch.set_num_threads(1)
            found = _both()
            ok = all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
        finally:
            os.write(writer, b"1" if ok else b"0")
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        done, _, _ = select.select([pipe], [], [], 60)
        answer = pipe.read(1) if done else b"it hangs"
    if not done:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert answer == b"1"


@pytest.mark.parametrize("threads", ["1", "2", "5"])
def test_any_number_of_threads(monkeypatch, expected, threads):
    import sdm.kernels.launch as launch

    monkeypatch.setenv("SDM_NUM_THREADS", threads)
    launch._pool.cache_clear()
    try:
        for found, wanted in zip(_both(), expected, strict=True):
            assert torch.equal(found, wanted)
    finally:
        launch._pool.cache_clear()
