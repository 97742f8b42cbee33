"""The benchmark of dirty meshes: a row, its shares of voxels, its picture."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.common.dirty_meshes.by_code import torn, turned
from sdm.bench.common.mesh_formulas import torus
from sdm.bench.common.meshes import Case, dirty_names, load_case
from sdm.bench.dense import dirty
from sdm.bench.dense.parts import dirty_cases


def test_a_row_says_what_decided_each_voxel(tmp_path):
    case = Case("torn", *torn(torus(1000), 0.2), frozenset(("open",)))
    found = dirty.row(case, "cpu", 12, 1)
    assert found["wrong_signs"] == 0
    assert found["boundary_edges"] > 100
    shares = found["looked_at"]["shares"]
    assert sum(shares.values()) == pytest.approx(1)
    assert min(shares.values()) >= 0
    assert list(shares) == list(dirty.DECIDED)
    picture = tmp_path / "dirty.png"
    dirty.draw({"machine": {"device": "cpu"}, "resolution": 12, "rows": [found]}, picture)
    assert picture.stat().st_size > 1000


def test_shares_add_up_where_no_small_box_is_left():
    case = Case("torn", *torn(torus(1000), 0.01), frozenset(("open",)))
    looked = dirty.row(case, "cpu", 24, 1)["looked_at"]
    assert "2^3" not in looked
    assert sum(looked["shares"].values()) == pytest.approx(1)


def test_a_closed_mesh_asks_no_box():
    case = Case("torus", *torus(256), frozenset(("closed",)))
    assert dirty.row(case, "cpu", 8, 1)["looked_at"] == {}


def test_turned_faces_are_the_same_faces():
    vertices, faces = torus(256)
    _, other = turned((vertices, faces), 0.5)
    assert 50 < (faces != other).any(1).sum() < 200
    assert (np.sort(faces, 1) == np.sort(other, 1)).all()


def test_files_of_a_folder_are_taken_by_the_beginning_of_their_names(tmp_path, monkeypatch):
    monkeypatch.setattr(dirty_cases, "missing_note", lambda name: f"{name} is not here")
    vertices, faces = torus(64)
    np.savez(tmp_path / "boeing.npz", vertices=vertices, faces=faces)
    np.savez(tmp_path / "another.npz", vertices=vertices, faces=faces)
    assert [(case.name, len(case)) for case in dirty_cases.of_files(tmp_path)] == [("boeing", 64)]


@pytest.mark.parametrize("name", dirty_names())
def test_dirty_meshes_are_meshes(name):
    case = load_case(name)
    assert np.isfinite(case.vertices).all()
    assert case.faces.min() >= 0
    assert case.faces.max() < len(case.vertices)
    assert len(case) >= 9


def test_a_row_of_the_same_mesh_is_replaced():
    rows = [{"mesh": "a", "ratio": 1.0}, {"mesh": "b", "ratio": 2.0}]
    assert dirty.replaced(rows, {"mesh": "a", "ratio": 3.0}) == [{"mesh": "a", "ratio": 3.0}, rows[1]]
    assert dirty.replaced(rows, {"mesh": "c", "ratio": 4.0}) == [*rows, {"mesh": "c", "ratio": 4.0}]
