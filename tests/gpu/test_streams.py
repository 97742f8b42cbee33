"""Any torch stream: what kernels read outlives them, and nothing waits for the device without need.

Every test queues a long sleep first, so that the kernels under test have not begun when their memory is let go of;
then it fills all the memory it can get with NaN on another stream. Memory that was given back too early would show.
"""

from __future__ import annotations

import gc
from collections.abc import Callable

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case

pytestmark = pytest.mark.gpu

NAMES = ["torus", "open hemisphere", "random soup"]
CYCLES = 400_000_000  # about a quarter of a second
GRID = sdm.Grid([-1.2] * 3, [0.04] * 3, [60] * 3)


@pytest.fixture(params=NAMES)
def mesh(request) -> sdm.TriangleMesh:
    case = load_case(request.param)
    return sdm.TriangleMesh(torch.tensor(case.vertices).cuda(), torch.tensor(case.faces).cuda())


@pytest.fixture
def points() -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).normal(size=(200_000, 3)).astype(np.float32)).cuda()


def _spoil() -> list[torch.Tensor]:
    """NaN in every block of memory that the allocator will hand out on the current stream, small and large."""
    gc.collect()
    nan = float("nan")
    blocks = [torch.full((1 << size,), nan, device="cuda") for size in range(2, 22) for _ in range(24)]
    return blocks + [torch.full((1 << 24,), nan, device="cuda") for _ in range(8)]


def _asleep(stream: torch.cuda.Stream) -> None:
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        torch.cuda._sleep(CYCLES)


def _check(work: Callable[[], torch.Tensor], expected: torch.Tensor) -> None:
    """`work` queues kernels on a side stream and drops all it made but its result."""
    side = torch.cuda.Stream()
    _asleep(side)
    with torch.cuda.stream(side):
        found = work()
    assert not side.query(), "the device was waited for, so this test proves nothing"
    kept = _spoil()
    torch.cuda.synchronize()
    assert torch.equal(found, expected)
    del kept


def test_an_index_dropped_after_its_query(mesh, points):
    expected = sdm.MeshIndex(mesh).signed_distance(points)
    indexes = [sdm.MeshIndex(mesh)]
    torch.cuda.synchronize()

    def work() -> torch.Tensor:
        return indexes.pop().signed_distance(points)

    _check(work, expected)


def test_an_index_dropped_after_its_map(mesh):
    index = sdm.MeshIndex(mesh)
    expected = torch.cat([values for _, _, values in index.slabs(GRID)])
    indexes = [index]
    del index
    torch.cuda.synchronize()

    def work() -> torch.Tensor:
        return torch.cat([values for _, _, values in indexes.pop().slabs(GRID, GRID.nbytes)])

    _check(work, expected)


def test_points_dropped_after_the_query(mesh, points):
    index = sdm.MeshIndex(mesh)
    expected = index.signed_distance(points, return_closest=True)[1].points
    given = [points.clone()]
    torch.cuda.synchronize()

    def work() -> torch.Tensor:
        return index.signed_distance(given.pop(), return_closest=True)[1].points

    _check(work, expected)


def test_a_hierarchy_that_lives_for_one_call(mesh, points):
    """Built and dropped inside the operator, on the side stream, and memory taken on the default one."""
    tensors, faces = mesh.vertices, mesh.faces
    # Edges are remembered with the faces, so that nothing has to wait.
    expected = torch.ops.sdm.distance(tensors, faces, points, [], 0)
    if not sdm.MeshIndex(mesh).closed:
        pytest.skip("a new open mesh waits once, for the number of its seams")
    torch.cuda.synchronize()
    _check(lambda: torch.ops.sdm.distance(tensors, faces, points, [], 0), expected)


def test_batches():
    case = load_case("torus")
    faces = torch.tensor(case.faces).cuda()
    batch = torch.stack([torch.tensor(case.vertices).cuda() * (1 + 0.1 * i) for i in range(4)])
    expected = sdm.signed_distance_maps(batch, faces, GRID)
    given = [batch.clone()]
    torch.cuda.synchronize()
    _check(lambda: sdm.signed_distance_maps(given.pop(), faces, GRID), expected)


def test_gradients_on_a_side_stream(mesh, points):
    def gradient() -> torch.Tensor:
        leaf = mesh.vertices.clone().requires_grad_()
        index = sdm.MeshIndex(sdm.TriangleMesh(leaf, mesh.faces, check=False))
        at = points[:20_000].clone().requires_grad_()
        index.signed_distance(at).sum().backward()
        assert at.grad is not None
        return at.grad

    expected = gradient()
    torch.cuda.synchronize()
    side = torch.cuda.Stream()
    _asleep(side)
    with torch.cuda.stream(side):
        found = gradient()
    kept = _spoil()
    torch.cuda.synchronize()
    assert torch.equal(found, expected)
    del kept


def test_an_update_between_two_queries(points):
    """The old hierarchy may be freed while the first query still waits for its turn."""
    case = load_case("torus")
    mesh = sdm.TriangleMesh(torch.tensor(case.vertices).cuda(), torch.tensor(case.faces).cuda())
    index = sdm.MeshIndex(mesh)
    first = index.signed_distance(points)
    moved = 1.5 * mesh.vertices
    torch.cuda.synchronize()
    side = torch.cuda.Stream()
    _asleep(side)
    with torch.cuda.stream(side):
        found = index.signed_distance(points)
        index.update(moved)
        second = index.signed_distance(points)
    kept = _spoil()
    torch.cuda.synchronize()
    assert torch.equal(found, first)
    assert torch.equal(second, sdm.MeshIndex(sdm.TriangleMesh(moved, mesh.faces)).signed_distance(points))
    del kept


def test_many_streams_at_once(points):
    meshes = [load_case(name) for name in NAMES * 3]
    expected = [sdm.MeshIndex(sdm.TriangleMesh(m.vertices, m.faces), "cuda").signed_distance(points) for m in meshes]
    torch.cuda.synchronize()
    streams = [torch.cuda.Stream() for _ in meshes]
    found = []
    for stream, case in zip(streams, meshes, strict=True):
        with torch.cuda.stream(stream):
            found.append(sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cuda").signed_distance(points))
    torch.cuda.synchronize()
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one, other)


@pytest.fixture
def no_waiting():
    """Torch raises where it would wait for the device."""

    def forbid() -> None:
        torch.cuda.set_sync_debug_mode("error")

    yield forbid
    torch.cuda.set_sync_debug_mode("default")


def test_queries_do_not_wait(no_waiting, points):
    case = load_case("torus")
    mesh = sdm.TriangleMesh(torch.tensor(case.vertices).cuda(), torch.tensor(case.faces).cuda())
    index = sdm.MeshIndex(mesh)
    batch = torch.stack([mesh.vertices, 2 * mesh.vertices])
    sdm.signed_distance_maps(batch, mesh.faces, GRID)
    torch.cuda.synchronize()
    no_waiting()
    index.signed_distance(points, return_closest=True)
    index.signed_distance_map(GRID)
    index.winding_number(points)
    at = points.clone().requires_grad_()
    index.signed_distance(at).sum().backward()
    # The hot path of the stream of training data: the faces are known from the batch before.
    leaf = batch.clone().requires_grad_()
    sdm.signed_distance_maps(leaf, mesh.faces, GRID).sum().backward()
