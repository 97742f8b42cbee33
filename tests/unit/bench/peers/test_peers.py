"""Every peer that is installed measures what the oracle measures, and one that is not says so."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm import Grid
from sdm.bench.common.meshes import load_case
from sdm.bench.peers import all_peers
from tests.helpers import oracle

NAMES = [peer.name for peer in all_peers("cpu")]
WITH_POINTS = [peer.name for peer in all_peers("cpu") if peer.points_too]

pytestmark = pytest.mark.filterwarnings("default")  # other libraries' warnings are theirs


@pytest.fixture(scope="module")
def asked():
    case = load_case("sphere")
    points = np.random.default_rng(3).uniform(-1.2, 1.2, (300, 3)).astype(np.float32)
    d, _, _ = oracle.distance(case.vertices, case.faces, points)
    w = oracle.winding_number(case.vertices, case.faces, points)
    return case, torch.from_numpy(points), np.where(w > 0.5, -d, d)


def made(name):
    return next(peer for peer in all_peers("cpu") if peer.name == name)


def ready(name, case):
    peer = made(name)
    if (note := peer.missing()) is not None:
        pytest.skip(note)
    peer.build(case)
    return peer


@pytest.mark.parametrize("name", WITH_POINTS)
def test_points(name, asked):
    case, points, expected = asked
    peer = ready(name, case)
    values = peer.signed_distance(points).numpy()
    # point-cloud-utils multiplies by its approximate winding number.
    np.testing.assert_allclose(values, expected, atol=5e-3 if name == "point-cloud-utils" else 2e-6)
    if "distance" in peer.parts:
        np.testing.assert_allclose(peer.unsigned_distance(points).numpy(), np.abs(expected), atol=2e-6)
    if "sign" in peer.parts:
        np.testing.assert_array_equal(peer.inside(points).numpy(), expected < 0)


@pytest.mark.parametrize("name", NAMES)
def test_maps(name, asked):
    case, _, _ = asked
    peer = ready(name, case)
    grid = Grid((-1.1, -1.0, -0.9), (0.4, 0.3, 0.5), (5, 6, 4))
    at = grid.points().numpy().reshape(-1, 3)
    d, _, _ = oracle.distance(case.vertices, case.faces, at)
    expected = np.where(oracle.winding_number(case.vertices, case.faces, at) > 0.5, -d, d).reshape(grid.shape)
    peer.prepare(grid)
    values = peer.signed_distance_map(grid).numpy()
    assert values.shape == grid.shape
    np.testing.assert_allclose(values, expected, atol=5e-3 if name == "point-cloud-utils" else 2e-6)


def test_what_is_not_installed_is_named(monkeypatch):
    peer = made("Open3D")
    monkeypatch.setattr(peer, "module", "no_such_library")
    assert peer.missing() == "Open3D is not installed"
    assert not peer.available()
    if not torch.cuda.is_available():
        assert "no CUDA device" in (all_peers("cuda")[0].missing() or "")


def test_both_trees_of_warp_are_peers_on_a_gpu():
    notes = {peer.name: peer.note for peer in all_peers("cuda")}
    assert notes["Warp winding number"] == "LBVH, leaf 4"
    assert notes["Warp winding number, SAH"] == "SAH, leaf 4"
    assert "Warp winding number, SAH" not in NAMES
