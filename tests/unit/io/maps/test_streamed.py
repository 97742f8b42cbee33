from __future__ import annotations

import gc
import os
import signal
import weakref
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.io import FORMATS, grid_like, load, write_streamed
from sdm.io.maps import zarr as zarr_io
from tests.helpers.processes.forked import Forked

BALL = trimesh.creation.icosphere(1)
GRID = Grid((-1.2, -1.3, -1.4), (0.31, 0.33, 0.37), (9, 8, 7))


def ball(faces: int = 80) -> TriangleMesh:
    return TriangleMesh(BALL.vertices.astype(np.float32), BALL.faces[:faces].astype(np.int32))


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format_gets_the_map_that_is_computed(ending, device, tmp_path):
    index = MeshIndex(ball(), device)
    done = []
    counts = write_streamed(index, GRID, tmp_path / f"map.{ending}", progress=done.append)
    assert counts == (load(tmp_path / f"map.{ending}").inside_voxels, 0)
    assert counts.inside > 0
    expected = index.signed_distance_map(GRID)
    again = load(tmp_path / f"map.{ending}")
    np.testing.assert_array_equal(again.numpy(), expected.numpy())
    assert (again.grid, again.ambiguous_voxels) == (GRID, 0)
    assert done[-1] == 1.0


@pytest.mark.parametrize("layers", [1, 32, 40, 64, 1000])
def test_slabs_of_any_size_give_the_same_map(layers, tmp_path, monkeypatch):
    monkeypatch.setattr(zarr_io, "SLAB_BYTES", 4 * 8 * 7 * layers)
    monkeypatch.setattr(zarr_io, "CHUNK", 32)
    grid = Grid((-1.2, -1.3, -1.4), (0.03, 0.33, 0.37), (90, 8, 7))
    index = MeshIndex(ball(), "cpu")
    done = []
    write_streamed(index, grid, tmp_path / "map.zarr", progress=done.append)
    np.testing.assert_array_equal(load(tmp_path / "map.zarr").numpy(), index.signed_distance_map(grid).numpy())
    assert done == sorted(done)
    assert len(done) == -(-90 // zarr_io.slab_layers(grid))


def test_an_open_mesh(tmp_path):
    index = MeshIndex(ball(60), "cpu")
    assert write_streamed(index, GRID, tmp_path / "map.nii").ambiguous > 0
    assert load(tmp_path / "map.nii").ambiguous_voxels == index.signed_distance_map(GRID).ambiguous_voxels


class Slabs(MeshIndex):
    """An index whose maps hold their layer's number, and which watches that slabs are let go."""

    closed = True  # pyright: ignore[reportAssignmentType]

    def __init__(self) -> None:
        self.mesh: Any = None
        self.device = torch.device("cpu")
        self.largest = 0

    def slabs(self, grid: Grid, max_bytes: int, *, ambiguous: torch.Tensor | None = None):
        layers = max(1, max_bytes // (4 * grid.shape[1] * grid.shape[2]))
        last = None
        for begin in range(0, grid.shape[0], layers):
            gc.collect()
            assert last is None or last() is None
            end = min(begin + layers, grid.shape[0])
            values = torch.arange(begin, end, dtype=torch.float32)[:, None, None].repeat(1, *grid.shape[1:])
            self.largest = max(self.largest, values.nbytes)
            last = weakref.ref(values)
            yield begin, end, values
            del values


def test_a_large_grid_is_never_whole_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(zarr_io, "SLAB_BYTES", 1 << 18)
    grid = Grid((0, 0, 0), (1, 1, 1), (100, 40, 30))
    index = Slabs()
    write_streamed(index, grid, tmp_path / "map.zarr")
    assert index.largest <= 1 << 18
    values = load(tmp_path / "map.zarr").numpy()
    assert (values == np.arange(100, dtype=np.float32)[:, None, None]).all()


@pytest.mark.parametrize("shape", [(5, 6, 7), (300, 300, 300), (2000, 2000, 2000), (3, 20000, 20000), (4000, 1, 1)])
def test_slabs_are_whole_chunks_within_their_bytes(shape):
    grid = Grid((0, 0, 0), (1, 1, 1), shape)
    layers = zarr_io.slab_layers(grid)
    assert layers == 32 or 4 * layers * shape[1] * shape[2] <= zarr_io.SLAB_BYTES
    assert layers % 32 == 0
    assert layers <= zarr_io.CHUNK or layers % zarr_io.CHUNK == 0


class Killed(MeshIndex):
    """An index whose process is killed at the fifth slab."""

    closed = True  # pyright: ignore[reportAssignmentType]

    def __init__(self) -> None:
        self.mesh: Any = None
        self.device = torch.device("cpu")

    def slabs(self, grid, max_bytes, *, ambiguous=None):
        for i in range(grid.shape[0]):
            if i == 5:
                os.kill(os.getpid(), signal.SIGKILL)
            yield i, i + 1, torch.zeros(1, *grid.shape[1:])


def streamed_until_killed(path) -> None:
    zarr_io.SLAB_BYTES = 1000
    write_streamed(Killed(), Grid((0, 0, 0), (1, 1, 1), (20, 20, 20)), path)


def test_a_stream_that_is_killed_leaves_no_map(tmp_path):
    path = tmp_path / "map.zarr"
    assert Forked(lambda: streamed_until_killed(path)).wait() == -signal.SIGKILL
    assert not path.exists()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".map.zarr.")
    assert left.name.endswith(".part")
    assert len(os.listdir(left)) == 2


def test_the_header_alone_is_read_for_the_grid(tmp_path):
    write_streamed(MeshIndex(ball(), "cpu"), GRID, tmp_path / "map.zarr")
    for chunk in (tmp_path / "map.zarr" / "c").rglob("*"):
        if chunk.is_file():
            chunk.unlink()
    assert grid_like(tmp_path / "map.zarr") == GRID
