"""Dense maps by pytest-benchmark: `pytest bench/dense/test_maps.py`. Checked first, compiling apart."""

from __future__ import annotations

import pytest

from sdm.bench.common import pytest_fixtures as shared
from sdm.bench.common.grids import cube_around
from sdm.bench.peers import Peer

# trimesh takes minutes for what the others do in a second.
RESOLUTION = {"cpu": 32, "cuda": 128}
SLOW = {"trimesh + embreex": 6}

pytestmark = pytest.mark.filterwarnings("default")  # other libraries' warnings are theirs


@pytest.mark.parametrize(("peer", "mesh"), shared.parameters(points=False))
def test_dense(benchmark, peer: Peer, mesh: str) -> None:
    case = shared.built(peer, mesh)
    resolution = SLOW.get(peer.name, RESOLUTION[peer.device])
    benchmark.group = f"{mesh} at {resolution}^3 on {peer.device}"
    grid = cube_around(case, resolution)
    peer.prepare(grid)
    at = grid.points().numpy().reshape(-1, 3)
    shared.check_then_time(benchmark, peer, case, at, lambda: peer.signed_distance_map(grid))
