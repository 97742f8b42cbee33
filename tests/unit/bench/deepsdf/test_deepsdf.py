"""DeepSDF's own recipe in miniature: what cameras see, who the neighbours are, what the recipe says; and the scales."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import KDTree
from torch.nn.functional import grid_sample

from sdm import FormatError, TriangleMesh
from sdm.bench.deepsdf import __main__ as deepsdf
from sdm.bench.deepsdf import approximate_samples
from sdm.bench.deepsdf import fit_picture as fit_picture
from sdm.bench.deepsdf import recipe_study as study
from sdm.bench.deepsdf.approximate_samples import ApproximateSamples, approximate, prepare
from sdm.bench.deepsdf.cameras import Cameras, seen_points
from sdm.bench.deepsdf.evaluate import summary
from sdm.bench.deepsdf.nearest import VOTES, Nearest
from sdm.bench.deepsdf.paper_scale import in_paper_scale
from sdm.bench.deepsdf.report import report
from sdm.deepsdf.samples import ShapeSet, UnitSphere, surface_points
from sdm.surrogate import GRID
from sdm.surrogate.train.accuracy import places_in_map

FEW = Cameras(views=12, pixels=48)


def ball(radius: float = 1.0, name: str = "ball") -> TriangleMesh:
    made = trimesh.creation.icosphere(3, radius)
    return TriangleMesh(made.vertices, made.faces, name)


def shell() -> TriangleMesh:
    """A ball with a hollow that no camera sees into."""
    outer, inner = trimesh.creation.icosphere(3, 0.9), trimesh.creation.icosphere(2, 0.4)
    inner.invert()
    vertices = np.concatenate([outer.vertices, inner.vertices])
    return TriangleMesh(vertices, np.concatenate([outer.faces, inner.faces + len(outer.vertices)]), "shell")


def test_cameras_are_spread_evenly() -> None:
    at = Cameras().directions()
    assert torch.allclose(at.norm(dim=1), torch.ones(100), atol=1e-6)
    assert float(at.mean(0).norm()) < 0.02
    # A hundred equal caps of the sphere would be 0.4 wide.
    apart = torch.cdist(at, at) + 9 * torch.eye(100)
    assert float(apart.min()) > 0.2


def test_cameras_see_the_outside_alone() -> None:
    points, normals = seen_points(shell(), FEW)
    # Of each image a disc: pi 0.9^2 of 4.
    assert len(points) == pytest.approx(12 * 48**2 * math.pi * 0.81 / 4, rel=0.03)
    radius = points.norm(dim=1)
    assert float(radius.min()) > 0.88
    assert float((normals * points).sum(1).min()) > 0
    assert torch.allclose(normals.norm(dim=1), torch.ones(len(normals)), atol=1e-5)


def test_a_face_that_looks_away_is_turned_around() -> None:
    made = trimesh.creation.icosphere(2, 0.9)
    made.invert()
    points, normals = seen_points(TriangleMesh(made.vertices, made.faces, check=False), FEW)
    assert float((normals * points).sum(1).min()) > 0


@pytest.mark.parametrize("count", [VOTES, 64, 1000])
def test_neighbours_are_those_of_a_kd_tree(count: int) -> None:
    random = np.random.default_rng(count)
    points, queries = random.random((count, 3), np.float32), 3 * random.random((500, 3), np.float32) - 1
    found = Nearest(torch.from_numpy(points))(torch.from_numpy(queries)).numpy()
    away, _ = KDTree(points.astype(np.float64)).query(queries.astype(np.float64), VOTES)
    assert np.abs(np.linalg.norm(points[found] - queries[:, None], axis=2) - away).max() < 1e-6
    assert all(len(set(row)) == VOTES for row in found)


def test_too_few_points_have_no_neighbours() -> None:
    with pytest.raises(ValueError, match="no 11 nearest"):
        Nearest(torch.zeros(VOTES - 1, 3))


def test_the_recipe_is_the_published_one() -> None:
    """Against its rules in words, sample by sample, in float64."""
    surface, normals = seen_points(ball(0.9), FEW)
    points = 2 * torch.rand(300, 3, generator=torch.Generator().manual_seed(3)) - 1
    values, kept = approximate(points, surface, normals, Nearest(surface), 0.07)
    tree = KDTree(surface.double().numpy())
    for point, value, keep in zip(points.double().numpy(), values.tolist(), kept.tolist(), strict=True):
        away, numbers = tree.query(point, VOTES)
        heights = ((point - surface[numbers].double().numpy()) * normals[numbers].double().numpy()).sum(1)
        distance = abs(heights[0]) if away[0] < 0.07 else away[0]
        positive = int((heights > 0).sum())
        assert abs(value) == pytest.approx(distance, abs=1e-6)
        assert keep == (positive in (0, VOTES))
        if keep:
            assert (value > 0) == (positive == VOTES)


def test_how_wrong_the_recipe_is() -> None:
    """On a ball it is nearly right; of a shell it does not know the hollow."""
    shapes = ShapeSet([ball(), shell()], "cpu")
    at, found, quality = prepare(shapes, 0, 4000, Cameras(40, 100))
    assert len(at) == len(found) == round(4000 * (1 - quality.thrown_away))
    assert quality.wrong_signs < 0.002
    assert quality.mean_error < 1e-3
    assert quality.mean_error_mm == pytest.approx(quality.mean_error * shapes.spheres[0].radius)
    assert quality.mean_error <= quality.percentile95_error <= quality.worst_error
    hollow = prepare(shapes, 1, 4000, FEW)[2]
    inside = 0.4**2 / (0.9**2 + 0.4**2)
    assert hollow.hidden > inside - 0.02
    assert hollow.wrong_signs > 0.05


def test_the_edge_of_a_cube_is_where_planes_mislead() -> None:
    """Off an edge the plane of the nearest point is 0.03 away, the edge further; eleven votes do not see it."""
    made = trimesh.creation.box((1.0, 1.0, 1.0))
    surface, normals = seen_points(TriangleMesh(made.vertices, made.faces), Cameras(40, 200))
    points = torch.tensor([[0.53, 0.53, 0.1], [0.53, 0.1, 0.1]])
    values, kept = approximate(points, surface, normals, Nearest(surface), 0.07)
    assert float(values[1]) == pytest.approx(0.03, abs=1e-5)
    assert not bool(kept[0]) or abs(float(values[0]) - 0.03 * math.sqrt(2)) > 0.01


def test_tables_are_kept_and_made_once(tmp_path, monkeypatch) -> None:
    shapes = ShapeSet([ball(name="one"), ball(2.0, "two")], "cpu")
    first = ApproximateSamples(shapes, 500, FEW, tmp_path)
    number = torch.tensor([1, 0])
    points, values = first.sample(number, 40, seed=3, step=5)
    assert points.shape == (2, 40, 3)
    assert torch.allclose(shapes.signed_distance(number, points), values, atol=5e-3)
    with monkeypatch.context() as patch:
        patch.setattr(approximate_samples, "prepare", lambda *_: pytest.fail("it was there"))
        again = ApproximateSamples(shapes, 500, FEW, tmp_path)
    assert again.qualities == first.qualities
    assert all(
        torch.equal(a, b) for a, b in zip(again.sample(number, 40, seed=3, step=5), (points, values), strict=True)
    )
    assert not torch.equal(again.sample(number, 40, seed=3, step=6).points, points)
    # The second was being written when the first run ended, and another run's tables are not taken.
    (tmp_path / "0001.pt").unlink()
    made = []
    monkeypatch.setattr(approximate_samples, "prepare", lambda *a: made.append(a[1]) or prepare(*a))
    ApproximateSamples(shapes, 500, FEW, tmp_path)
    ApproximateSamples(shapes, 400, FEW, tmp_path)
    assert made == [1, 0, 1]


def part_of(mesh: TriangleMesh) -> dict:
    """Scores in unit-sphere radii, as they were before the paper's scale."""
    unit = UnitSphere.of(mesh).normalised(mesh)
    a, b = (surface_points(unit, 30_000, seed=n)[0].numpy() for n in (0, 1))
    floor = 2000 * float((KDTree(a).query(b)[0] ** 2).mean())
    rows = [{"chamfer": 3 * floor, "chamfer_floor": floor}]
    return {"without_a_surface": 0, **summary(rows), "rows": rows}


def test_the_papers_scale_has_a_diagonal_of_one() -> None:
    made = trimesh.creation.box((3.0, 4.0, 12.0)).subdivide()
    mesh = TriangleMesh(made.vertices, made.faces, "box")
    part = part_of(mesh)
    found = in_paper_scale(part, [mesh, ball()])
    # The sphere is around the box: its diameter is the diagonal, and 3 % more.
    assert found["rows"][0]["diagonal"] == pytest.approx(2 / 1.03, rel=1e-6)
    assert found["mean"]["chamfer_paper"] == pytest.approx(part["mean"]["chamfer"] * (1.03 / 2) ** 2, rel=1e-6)
    assert found["median"]["chamfer_paper_floor"] == pytest.approx(found["mean"]["chamfer_paper"] / 3, rel=1e-6)


def test_scores_of_other_shapes_are_told() -> None:
    part = part_of(ball())
    other = trimesh.creation.box((3.0, 4.0, 12.0))
    with pytest.raises(FormatError, match="another shape"):
        in_paper_scale(part, [TriangleMesh(other.vertices, other.faces, "box")])
    with pytest.raises(FormatError, match="evaluate again"):
        in_paper_scale(part | {"without_a_surface": 1}, [ball()])


@pytest.mark.slow
def test_the_study_runs_goes_on_and_is_reported(tmp_path, monkeypatch, capsys) -> None:
    out = tmp_path / "tiny-recipe"
    words = "recipe cochlea --count 3 --test 1 --known 1 --table 2000 --views 6 --pixels 40 --epochs 30 --steps 10 "
    words += "--resolution 32 --triangles 600 --width 32 --layers 2 --points 200 --device cpu --seeds 2 --out"
    monkeypatch.setattr(sys, "argv", ["deepsdf", *words.split(), str(out)])
    deepsdf.main()
    found = json.loads((out / "scores.json").read_text())
    assert study.is_study(found)
    done = study.trainings(found)
    assert [(d["samples"], d["seed"]) for d in done] == [(k, s) for s in (0, 1) for k in ("exact", "approximate")]
    # As many steps of the same network, whatever the samples.
    assert len({(d["training"]["steps"], d["training"]["model_mib"]) for d in done}) == 1
    assert done[0]["unseen"]["rows"][0]["mean_mm"] != done[1]["unseen"]["rows"][0]["mean_mm"]
    # What is there is not done again.
    found["exact 0"]["known"]["mean"]["mean_mm"] = 7.0
    del found["approximate 1"]
    (out / "scores.json").write_text(json.dumps(found))
    deepsdf.main()
    again = json.loads((out / "scores.json").read_text())
    assert again["exact 0"]["known"]["mean"]["mean_mm"] == 7.0
    assert again["approximate 1"]["training"] == done[3]["training"]
    report([out], tmp_path / "results")
    page = (tmp_path / "results" / "deepsdf.md").read_text()
    assert "unseen: approximate less exact, seed 1" in page
    assert (tmp_path / "results" / "deepsdf_recipe.png").stat().st_size > 10_000
    capsys.readouterr()


def test_a_surrogates_map_is_read_at_a_labels_voxels() -> None:
    """A map of x + 2 y + 4 z on the surrogate's grid, at places between its voxels."""
    places = [GRID.origin[axis] + GRID.spacing[axis] * torch.arange(n) for axis, n in enumerate(GRID.shape)]
    x, y, z = torch.meshgrid(*places, indexing="ij")
    at = torch.tensor([0.13, -0.42, 1.01]) + 0.17 * torch.rand(3, 4, 5, 3, generator=torch.Generator().manual_seed(0))
    found = grid_sample((x + 2 * y + 4 * z)[None, None], places_in_map(at)[None], align_corners=True)
    assert torch.allclose(found[0, 0], at @ torch.tensor([1.0, 2, 4]), atol=1e-5)


def test_the_picture_of_fits(tmp_path) -> None:
    row = {"seconds": 2.0, "mean_mm": 0.03, "failed": False}
    fits = {way: {"failed": 0, "rows": [row, {"failed": True, "why": "no surface"}]} for way in fit_picture.WAYS}
    maps = {f"{way}_ms": 5.0 for way in fit_picture.WAYS}
    found = {"machine": {"device": "a", "cores": 1}, "maps": maps, "fits": fits}
    assert fit_picture.is_fit(found)
    assert not fit_picture.is_fit(found | {"fits": {"mesh": fits["mesh"]}})
    fit_picture.picture({"run": found}, tmp_path / "fits.png")
    assert (tmp_path / "fits.png").stat().st_size > 5_000
