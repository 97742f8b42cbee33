"""The benchmark of surfaces: rows of a small mesh, and their picture."""

from __future__ import annotations

import numpy as np

import sdm
from sdm.bench.common.meshes import load_case
from sdm.bench.surface.__main__ import errors, measure
from sdm.bench.surface.figures import draw
from sdm.bench.surface.methods import OURS


def test_rows_and_picture(tmp_path):
    rows = {row["method"]: row for row in measure(load_case("sphere"), "cpu", 24, 1)}
    assert set(rows) >= {*OURS, "scikit-image"}
    for method in OURS:
        assert rows[method]["open"] == rows[method]["zero"] == 0
        assert rows[method]["vertices"] < 0.3
    assert rows["sdm cubes"]["triangles"] == rows["scikit-image"]["triangles"]
    draw({"rows": list(rows.values()), "machine": {"device": "a CPU", "cores": 2}}, tmp_path / "surface.png")
    assert (tmp_path / "surface.png").stat().st_size > 1000


def test_a_hole_is_counted():
    case = load_case("sphere")
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    found = errors((np.asarray(case.vertices), np.asarray(case.faces)[1:]), mesh, None, 1.0)
    assert (found["open"], found["zero"], found["edges"]) == (6, 0, None)
