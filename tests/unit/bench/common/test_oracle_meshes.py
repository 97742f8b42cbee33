"""The shared meshes are what their tags say, by the oracle's winding number."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.common import meshes
from tests.helpers.oracle import distance, winding_number


def balanced(case):
    """True if every edge runs as often one way as the other, vertices at equal positions being one."""
    _, same = np.unique(case.vertices + 0.0, axis=0, return_inverse=True)
    faces = same.reshape(-1)[case.faces]
    a, b = faces.reshape(-1), np.roll(faces, -1, 1).reshape(-1)
    total = {}
    for low, high, sign in zip(np.minimum(a, b), np.maximum(a, b), np.sign(b - a), strict=True):
        total[low, high] = total.get((low, high), 0) + sign
    return not any(total.values())


@pytest.mark.parametrize("name", meshes.generated_names())
def test_tags(name):
    case = meshes.load_case(name)
    assert case.vertices.dtype == np.float32
    assert case.faces.dtype == np.int32
    assert case.faces.min() >= 0
    assert case.faces.max() < len(case.vertices)
    assert np.isfinite(case.vertices).all()
    assert "generated" in case.tags
    if name != "collinear soup":
        assert balanced(case) == ("closed" in case.tags)


@pytest.mark.parametrize("name", meshes.names(["generated", "closed"]))
def test_closed_meshes_have_whole_winding_numbers(name):
    case = meshes.load_case(name)
    low, high = case.box
    points = np.random.default_rng(1).uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (60, 3))
    points = points.astype(np.float32)
    w = winding_number(case.vertices, case.faces, points)
    d, _, _ = distance(case.vertices, case.faces, points)
    clear = d > 1e-6 * (high - low).max()
    np.testing.assert_allclose(w[clear], np.round(w[clear]), atol=1e-6)
    if "smooth" in case.tags:
        assert 0 < (w > 0.5).mean() < 1
        assert w.min() > -0.5
    if "inverted" in case.tags:
        assert w.min() < -0.5


@pytest.mark.parametrize(("name", "thickest"), [("needle box", 1e-6), ("needle fan", 1e-3), ("loose slivers", 1e-6)])
def test_slivers_are_slivers(name, thickest):
    case = meshes.load_case(name)
    assert "sliver" in case.tags
    a, b, c = np.moveaxis(case.vertices[case.faces].astype(float), 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert (area / sum(((p - q) ** 2).sum(1) for p, q in ((a, b), (b, c), (c, a)))).min() < thickest


def test_torus_of_a_million():
    vertices, faces = meshes.torus(1_000_000)
    assert abs(len(faces) - 1_000_000) < 5000
    assert len(vertices) * 2 == len(faces)


def test_missing_files_are_explained(monkeypatch, tmp_path):
    monkeypatch.setenv("SDM_DATA", str(tmp_path))
    assert "set SDM_DATA" in str(meshes.missing_note("nefertiti"))
    with pytest.raises(FileNotFoundError, match=r"no nefertiti\.ply"):
        meshes.load_case("nefertiti")
    assert meshes.missing_note("cube") is None
    with pytest.raises(KeyError, match="no mesh called"):
        meshes.load_case("teapot")


@pytest.mark.skipif(meshes.missing_note("fandisk") is not None, reason="the real meshes are not here: set SDM_DATA")
def test_real_mesh_is_read():
    assert len(meshes.load_case("fandisk")) == 12_946
    assert {"real", "closed"} <= meshes.load_case("fandisk").tags
