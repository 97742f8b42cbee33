"""Warp's views of torch's memory: remembered by address, right for whatever is there now."""
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false, reportArgumentType=false

from __future__ import annotations

import gc
import threading
import weakref

import numpy as np
import pytest
import torch
import warp as wp

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.kernels.launch import launch, set_array
from sdm.runtime.torch_warp import array_at, as_warp, workspace


@wp.kernel(enable_backward=False)
def _scale(begin: int, by: int, offset: float, source: wp.array(dtype=wp.float32), target: wp.array(dtype=wp.float32)):
    i = begin + wp.tid()
    target[i] = float(by) * source[i] + offset


@wp.kernel(enable_backward=False)
def _fill(begin: int, number: int, target: wp.array(dtype=wp.int32)):
    target[begin + wp.tid()] = number


def _scaled(count: int, by: int, offset: float) -> bool:
    source = torch.arange(count, dtype=torch.float32)
    target = torch.full((count + 1,), -1.0)
    launch(_scale, count, [by, offset, as_warp(source, wp.float32), as_warp(target, wp.float32)], "cpu")
    return torch.equal(target[:count], by * source + offset) and float(target[count]) == -1


def test_a_launch_does_what_its_own_arguments_say():
    for count, by, offset in ((10, 2, 0.5), (10, 3, 0.5), (700, 2, -1.0), (10, 2, 0.5), (1, -1, 0.0)):
        assert _scaled(count, by, offset)


def test_a_launch_after_a_refused_one():
    assert _scaled(5, 2, 0.0)
    room = as_warp(torch.zeros(9), wp.float32)
    for wrong in ([2, 0.0, room], [2, 0.0, room, as_warp(torch.zeros(9, dtype=torch.int32), wp.int32)]):
        with pytest.raises(RuntimeError, match="_scale"):
            launch(_scale, 9, wrong, "cpu")
    assert _scaled(5, 2, 0.0)


def test_many_threads_launch_at_once():
    wrong = []

    def work(number: int) -> None:
        wrong.extend(n for n in range(200) if not _scaled(1 + (number * 37 + n) % 90, number, float(n)))

    threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_vectors_lose_their_last_axis():
    assert as_warp(torch.zeros(4, 3), wp.vec3).shape == (4,)
    assert as_warp(torch.zeros(2, 5, 3), wp.vec3).shape == (2, 5)
    assert as_warp(torch.zeros(0, 3), wp.vec3).shape == (0,)


@pytest.mark.parametrize(
    ("tensor", "dtype"),
    [
        (torch.zeros(4, 3).T, wp.float32),
        (torch.zeros(4, 2), wp.vec3),
        (torch.zeros(3), wp.float64),
        (torch.zeros(4, 3, dtype=torch.float64), wp.vec3),
    ],
)
def test_what_is_no_such_array(tensor, dtype):
    with pytest.raises(ValueError, match="is no"):
        as_warp(tensor, dtype)


def test_scratch_arrays_share_no_byte():
    empty = workspace(torch.device("cpu"))
    sizes = [1, 1000, 0, 7, 1 << 16, (1 << 16) + 1, 3, 1 << 16, 1 << 16, 1 << 16, 5, 1 << 20, 2]
    arrays = [empty(size, wp.int32) for size in sizes]
    for number, array in enumerate(arrays):
        launch(_fill, array.size, [number, array], "cpu")
    for number, (size, array) in enumerate(zip(sizes, arrays, strict=True)):
        assert array.shape == (size,)
        assert array.ptr % 64 == 0
        assert (array.numpy() == number).all()
    assert empty(7, wp.vec3).capacity == 84


def test_an_address_used_again_by_another_mesh():
    """Hierarchies of the same size come to lie where others lay; each gives its own distances."""
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    vertices, faces = sphere(8)
    grid = sdm.Grid([-1.2] * 3, [0.3] * 3, [9] * 3)
    for scale in (1.0, 0.5, 1.5, 1.0):
        index = sdm.MeshIndex(sdm.TriangleMesh(np.float32(scale) * vertices, faces), "cpu")
        fresh = sdm.signed_distance(index.mesh, points, device="cpu")
        assert torch.equal(index.signed_distance(points), fresh)
        kept = index.signed_distance_map(grid).values
        at = torch.stack(torch.meshgrid(*[torch.tensor(a) for a in grid_axes(grid)], indexing="ij"), -1).float()
        assert torch.allclose(kept, index.signed_distance(at), atol=1e-6)
        del index


def grid_axes(grid: sdm.Grid) -> list[np.ndarray]:
    return [o + s * np.arange(n) for o, s, n in zip(grid.origin, grid.spacing, grid.shape, strict=True)]


def test_a_hierarchy_is_let_go_with_its_index():
    index = sdm.MeshIndex(sdm.TriangleMesh(*cube()), "cpu")
    index.signed_distance(np.zeros((3, 3), np.float32))
    index.signed_distance_map(sdm.Grid([0, 0, 0], [0.5] * 3, [4, 4, 4]))
    held = index._structure.tensors
    block = weakref.ref(held[0].untyped_storage())
    assert held[0].untyped_storage().data_ptr() == held[-1].untyped_storage().data_ptr()
    tensors = [weakref.ref(tensor) for tensor in held]
    del index, held
    gc.collect()
    assert block() is None
    assert all(tensor() is None for tensor in tensors)


@wp.struct
class _Inner:
    vectors: wp.array(dtype=wp.vec3)


@wp.struct
class _Outer:
    inner: _Inner
    numbers: wp.array(dtype=wp.float64)


@pytest.mark.parametrize(("shape", "dtype"), [((7,), wp.vec3), ((0,), wp.int32), ((2, 5, 3, 4), wp.float32)])
def test_an_array_is_the_one_that_warp_makes(shape, dtype):
    memory = torch.zeros(4096, dtype=torch.uint8)
    made = array_at(memory.data_ptr(), shape, dtype, memory.device)
    expected = wp.array(ptr=memory.data_ptr(), dtype=dtype, shape=shape, device="cpu", copy=False)
    assert bytes(made.__ctype__()) == bytes(expected.__ctype__())
    without = {"ctype"}
    assert {k: v for k, v in vars(made).items() if k not in without} == {
        k: v for k, v in vars(expected).items() if k not in without
    }
    # Its type's other arrays have attributes of their own.
    other = array_at(memory.data_ptr() + 1024, shape, dtype, memory.device)
    made.mark_read()
    assert not other._is_read


def test_one_map_of_four_gibibytes_has_an_array():
    """Its outer stride does not fit into the 32 bits that kernels read, and nothing steps along that axis."""
    made = array_at(1 << 20, (1, 1024, 1024, 1024), wp.float32, torch.device("cpu"))
    assert made.shape == (1, 1024, 1024, 1024)
    assert tuple(made.__ctype__().strides) == ((1 << 31) - 1, 1 << 22, 1 << 12, 4)
    with pytest.raises(ValueError, match="split it"):
        array_at(1 << 20, (2, 1024, 1024, 1024), wp.float32, torch.device("cpu"))


def test_a_struct_is_the_one_that_warp_fills():
    memory = torch.zeros(4096, dtype=torch.uint8)
    vectors = array_at(memory.data_ptr(), (3,), wp.vec3, memory.device)
    numbers = array_at(memory.data_ptr() + 512, (9,), wp.float64, memory.device)
    made, expected = _Outer(), _Outer()
    set_array(made.inner, "vectors", vectors)
    set_array(made, "numbers", numbers)
    expected.inner.vectors, expected.numbers = vectors, numbers
    assert bytes(made.__ctype__()) == bytes(expected.__ctype__())
    assert made.inner.vectors is vectors
    assert made.numbers is numbers
