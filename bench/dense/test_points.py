"""Scattered points by pytest-benchmark: `pytest bench/dense/test_points.py`. Checked first, compiling apart."""

from __future__ import annotations

import pytest
import torch

from sdm.bench.common import pytest_fixtures as shared
from sdm.bench.peers import Peer

COUNT = {"cpu": 20_000, "cuda": 1_000_000}
SLOW = {"trimesh + embreex": 300}

pytestmark = pytest.mark.filterwarnings("default")


@pytest.mark.parametrize(("peer", "mesh"), shared.parameters(points=True))
def test_points(benchmark, peer: Peer, mesh: str) -> None:
    case = shared.built(peer, mesh)
    count = SLOW.get(peer.name, COUNT[peer.device])
    benchmark.group = f"{mesh} at {count:,} points on {peer.device}"
    at = shared.scattered(case, count)
    on_device = torch.from_numpy(at).to(peer.device)
    shared.check_then_time(benchmark, peer, case, at, lambda: peer.signed_distance(on_device))
