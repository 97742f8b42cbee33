"""Small maps on a GPU: blocks measured together, and recordings by turns: the same bits."""

from __future__ import annotations

import random

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.mesh_formulas import sphere, torus
from sdm.bench.dense.live import frames_of
from sdm.engine.plan_override import plan_override
from sdm.runtime import graphs
from sdm.runtime.graphs import replay
from sdm.runtime.graphs.replay import MOST_RECORDINGS
from tests.helpers.same_bits import assert_same_bits

pytestmark = pytest.mark.gpu


def _random(count, seed, vertices=None):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(vertices or max(3, count // 2), 3)).astype(np.float32)
    return points, rng.integers(0, len(points), (count, 3)).astype(np.int32)


MESHES = {
    "161": _random(161, 161),
    "5119": _random(5119, 5119),
    "all alike": (_random(3, 0, 3)[0], np.tile(np.array([[0, 1, 2]], np.int32), (3000, 1))),
    "torus": torus(5000),
    "sphere": sphere(30),
}


@pytest.mark.parametrize("resolution", [20, 32, 50, 64])
@pytest.mark.parametrize("name", list(MESHES))
def test_the_same_map_by_one_group_of_lanes_and_by_all_of_a_thread_block(name, resolution):
    mesh = sdm.TriangleMesh(*MESHES[name])
    grid = sdm.Grid.around(mesh, resolution=resolution)
    index = sdm.MeshIndex(mesh, "cuda", warn=False)
    for split_length in (32, 10**6):
        with graphs.paused(), plan_override(split_length=split_length, block_shares=1, block_parts=1):
            alone = index.signed_distance_map(grid)
        for shares in (1, 2, 4):
            with graphs.paused(), plan_override(split_length=split_length, block_shares=shares, block_parts=4):
                together = index.signed_distance_map(grid)
            assert_same_bits(together.values, alone.values, (split_length, shares))
            assert together.ambiguous_voxels == alone.ambiguous_voxels


def _moving(triangles, resolution):
    """A way to ask for frames, vertices of some, and the last one's map, made without a recording."""
    vertices, faces = (torch.from_numpy(array).cuda() for array in torus(triangles))
    grid = sdm.Grid((-1.4,) * 3, (2.8 / (resolution - 1),) * 3, (resolution,) * 3)
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces, check=False), warn=False)
    moved = frames_of(vertices, 5)

    def frame(given):
        index.update(given)
        return index.signed_distance_map(grid).values

    with graphs.paused():
        expected = frame(moved[-1]).clone()
    return frame, moved, expected


def test_recordings_by_turns_and_driven_out_on_two_streams(monkeypatch):
    """More than are kept, in any order, in memory that holds what other work has left there."""
    graphs.clear()
    monkeypatch.setattr(replay, "_caches", {})
    monkeypatch.setattr(replay, "MOST_OF_MANY", MOST_RECORDINGS)
    draw = random.Random(1)
    kinds = [_moving(triangles, resolution) for resolution in (32, 64) for triangles in range(300, 9000, 480)]
    assert len(kinds) > MOST_RECORDINGS
    side = torch.cuda.Stream()
    for _ in range(3):
        for frame, moved, expected in draw.sample(kinds, len(kinds)):
            torch.full((1 << draw.randrange(10, 24),), 0x7FFFFF00, dtype=torch.int32, device="cuda")
            stream = draw.choice([side, torch.cuda.current_stream()])
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                for given in draw.choice([1, 3]) * moved:
                    found = frame(given)
                assert torch.equal(found, expected)
            torch.cuda.current_stream().wait_stream(stream)
    graphs.clear()
