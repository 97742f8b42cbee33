"""sdm.bench.dense runs in miniature from end to end, keeps what it wrote before, and its arithmetic is right."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

import sdm
from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import load_case
from sdm.bench.dense import __main__ as dense
from sdm.bench.dense import job as common
from sdm.bench.dense import plot_results
from sdm.bench.dense.parts import closest, signs, table, worst
from sdm.bench.peers import LibiglWinding, Peer
from sdm.engine.plan_override import OPTIONS
from sdm.kernels.plan_options import PlanOptions

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def results(tmp_path):
    """Two parts in miniature, in one file."""
    out = tmp_path / "dense.json"
    words = ["--device", "cpu", "--quick", "--budget-s", "300", "--out", str(out)]
    assert dense.main([*words, "--parts", "table", "--meshes", "cube", "--resolutions", "8", "12"]) == 0
    assert dense.main([*words, "--parts", "resolution"]) == 0
    return out


def test_parts_gather_in_one_file(results, capsys):
    parts = json.loads(results.read_text())["parts"]
    assert list(parts) == ["table", "resolution"]
    assert {"commit", "clocks", "versions", "device"} <= set(parts["table"]["machine"])
    first = parts["table"]["rows"][0]
    assert (first["mesh"], first["resolution"], first["checked"]["wrong_signs"]) == ("cube", 8, 0)
    assert first["ratio"] == min(first["ratios"].values())
    assert parts["resolution"]["rows"][-1]["layers"] == parts["resolution"]["rows"][-1]["resolution"]
    assert not list(results.parent.glob(".*"))


def test_plots_of_it(results, tmp_path, capsys):
    assert plot_results.main([str(results), "--out", str(tmp_path / "plots")]) == 0
    written = {path.name for path in (tmp_path / "plots").iterdir()}
    assert written == {"dense-ratios.png", "dense-speed.png", "dense-resolution.png"}


def test_a_file_of_something_else_is_refused(tmp_path, capsys):
    other = tmp_path / "other.json"
    other.write_text("[1]")
    assert dense.main(["--device", "cpu", "--parts", "table", "--out", str(other)]) == 2
    assert plot_results.main([str(other)]) == 2
    assert capsys.readouterr().err.count("holds no results") == 2
    assert other.read_text() == "[1]"


def test_thick_slices(capsys, tmp_path):
    out = tmp_path / "dense.json"
    assert dense.main(["--device", "cpu", "--quick", "--budget-s", "300", "--parts", "slices", "--out", str(out)]) == 0
    part = json.loads(out.read_text())["parts"]["slices"]
    meshes = ["torus-2000"] * 2 + ["torus-2000 with holes"] * 2
    assert [(row["mesh"], row["slices"]) for row in part["rows"]] == list(zip(meshes, [12, 6, 12, 6], strict=True))
    assert part["summary"]["wrong"] == 0
    assert all(row["checked"]["near_surface"] > 0 for row in part["rows"])
    # The finer grid is for the map alone, and the options are the usual ones again.
    assert OPTIONS.get() == PlanOptions()
    assert "12 of 48^2" in capsys.readouterr().out


def test_what_a_sign_costs():
    job = common.Job("cpu", quick=True, budget_s=20)
    rows = list(signs.rows(job))
    assert [(row["closed"], row["boundary_edges"] > 0) for row in rows] == [(True, False), (False, True)]
    assert all(row["ratio"] == row["signed"]["ms"] / row["unsigned"]["ms"] for row in rows)
    case = load_case("torus-2000")
    ours, grid = common.Ours(case, "cpu"), cube_around(case, 16)
    with signs.unsigned():
        alone = ours.map(grid)
    assert bool((alone >= 0).all())
    np.testing.assert_array_equal(alone, ours.map(grid).abs())


def test_a_peer_that_is_not_here_is_said(monkeypatch):
    monkeypatch.setattr(table.Open3D, "module", "no_such_module")
    job = common.Job("cpu", quick=True, budget_s=20)
    assert "Open3D" not in [peer.name for peer in table.rivals(job)]
    assert any(note.startswith("Open3D ") and note.endswith("the table is without it") for note in job.notes)


def test_budget_over_is_said():
    job = common.Job("cpu", quick=True, budget_s=1e-9)
    assert list(table.rows(job, ("cube",), (8,))) == []
    # Before it is said which peers are not here.
    assert job.notes[-1] == "cube at 8^3 was left out: the part's 1e-09 s were over"


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_slabs_lie_in_the_grid_and_are_its_voxels(share):
    case = load_case("cube")
    grid = sdm.Grid((0.1, 0.2, -0.3), (0.5, 0.25, 1.0), (37, 3, 2))
    slabs = common.slabs_of(case, grid, share)
    assert all(0 <= begin < end - 1 < 37 for begin, end in slabs)
    assert all(left[1] <= right[0] for left, right in itertools.pairwise(slabs))
    assert sum(end - begin for begin, end in slabs) == (37 if share == 1 else pytest.approx(37 * share, abs=16))
    begin, end = slabs[-1]
    np.testing.assert_allclose(common.part_of(grid, begin, end).points(), grid.points()[begin:end], atol=1e-6)


def test_slabs_are_as_large_as_a_peer_with_threads_needs():
    """libigl stays on one thread below 10,000 points a call."""
    grid = sdm.Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (64, 64, 64))
    for share in (1 / 64, 0.25, 0.9):
        slabs = common.slabs_of(load_case("cube"), grid, share, LibiglWinding.fewest_points)
        assert all((end - begin) * 64 * 64 >= 10_000 for begin, end in slabs)
        assert all(left[1] <= right[0] for left, right in itertools.pairwise(slabs))
    small = sdm.Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (8, 8, 8))
    assert common.slabs_of(load_case("cube"), small, 0.1, 10_000) == [(0, 8)]


class Backwards(Peer):
    """A peer that has inside and outside exchanged."""

    name = package = module = "backwards"

    def build(self, case):
        self.index = sdm.MeshIndex(sdm.TriangleMesh(case.vertices, case.faces), "cpu")

    def signed_distance(self, points):
        return -self.index.signed_distance(points)


def test_a_peer_with_other_signs_is_noticed():
    case = load_case("cube")
    grid = cube_around(case, 12)
    peer = Backwards()
    peer.build(case)
    values = sdm.signed_distance_map(sdm.TriangleMesh(case.vertices, case.faces), grid, device="cpu").values
    row = common.time_peer(common.Job("cpu", True, 1.0), peer, case, grid, values, 1.0)
    assert row["share"] == 1
    assert row["signs_unlike_ours"] == grid.size
    assert row["largest_difference"] < 1e-6


def test_summary_is_a_geometric_mean():
    rows = [
        {"resolution": 64, "ratio": r, "ratios": {"a": r, "b": 3 * r}, "checked": {"wrong_signs": w, "over_limit": 0}}
        for r, w in ((2.0, 0), (8.0, 1))
    ]
    total = table.summary(rows)
    assert total["geometric_means"]["64"] == pytest.approx({"meshes": 2, "fastest peer": 4, "a": 4, "b": 12})
    assert total["wrong"] == 1


def test_exponent_of_a_power():
    sizes = [10.0, 100.0, 1000.0]
    assert common.exponent(sizes, [3 * x**0.7 for x in sizes]) == pytest.approx(0.7)


def test_hard_meshes_are_what_they_say():
    vertices, faces = worst.one_voxel(1000, 16)
    grid = sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution=16)
    tiny = vertices[8:]
    assert len(faces) == pytest.approx(1000, rel=0.1)
    place = (tiny - np.asarray(grid.origin)) / np.asarray(grid.spacing)
    assert (np.ptp(np.round(place), axis=0) <= 1).all()
    assert np.ptp(tiny, axis=0).max() < grid.spacing[0]
    _, twice = worst.coincident(1000, 2)
    assert len(twice) % 2 == 0


def test_wrong_maps_give_exit_code_1(monkeypatch, capsys):
    right = common.Ours.map_new
    monkeypatch.setattr(common.Ours, "map_new", lambda self, grid: -right(self, grid))
    words = ["--device", "cpu", "--quick", "--parts", "table"]
    assert dense.main([*words, "--meshes", "cube", "--resolutions", "8"]) == 1


def test_every_part_has_its_functions():
    import importlib

    for part in dense.BUDGETS_S:
        module = importlib.import_module(f"sdm.bench.dense.parts.{part}")
        assert callable(module.rows)
        assert callable(module.summary)
        assert callable(module.lines)


def test_closest_points_are_checked_and_timed():
    job = common.Job("cpu", quick=True, budget_s=20, runs=1)
    found = list(closest.rows(job))
    assert [row["resolution"] for row in found] == [16]
    assert found[0]["same_values"]
    assert closest.summary(found)["wrong"] == 0
    assert closest.summary(found)["ratio"] > 0
    assert "torus-2000" in closest.lines(found, closest.summary(found))[1]
