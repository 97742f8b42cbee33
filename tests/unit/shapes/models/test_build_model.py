"""Shape models from meshes: in correspondence and without, their files, and the commands."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.cli import main
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError, MeshError
from sdm.io import save_mesh
from sdm.shapes import StatisticalShape, load_family
from sdm.shapes.models import lay_template
from sdm.shapes.models.build_model import build_model
from sdm.shapes.models.procrustes import procrustes
from sdm.shapes.models.sdm_modes import SDMModes


@pytest.fixture(autouse=True)
def few_points(monkeypatch) -> None:
    """Balls have no thin parts that few points might miss."""
    monkeypatch.setattr(lay_template, "SAMPLES", 500)


@pytest.fixture(scope="module")
def truth() -> StatisticalShape:
    return StatisticalShape.example()


@pytest.fixture(scope="module")
def meshes(truth) -> list[TriangleMesh]:
    """Eight ellipsoids, turned and moved."""
    theta = truth.sample(8, seed=3, device="cpu")
    found = []
    for number, points in enumerate(truth.vertices(theta)):
        angle = 0.1 * number
        turn = torch.tensor([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        moved = points @ turn.float().T + torch.tensor([number, 1.0, -2.0])
        found.append(TriangleMesh(moved, truth.faces, f"ball-{number}"))
    return found


def test_vertices_are_mean_and_modes_and_have_gradients(truth):
    theta = torch.tensor([[1.0, 0.0, -2.0]], requires_grad=True)
    points = truth.vertices(theta)
    expected = truth.mean * torch.tensor([1.1, 1.0, 0.8])
    torch.testing.assert_close(points[0].detach(), expected)
    (found,) = torch.autograd.grad(points[0, :, 0].square().sum(), theta)
    assert float(found[0, 0]) == pytest.approx(float((2 * 1.1 * 0.1 * truth.mean[:, 0] ** 2).sum()), rel=1e-4)
    torch.testing.assert_close(truth.project(points.detach())[0], theta[0].detach(), rtol=1e-4, atol=1e-5)


def test_samples_are_normal_and_a_batch_has_the_bits_of_its_shapes(truth):
    theta = truth.sample(4000, seed=1, device="cpu")
    assert float(theta.std()) == pytest.approx(0.987, abs=0.02)
    assert float(theta.abs().max()) <= 3
    torch.testing.assert_close(truth.from_unit(truth.to_unit(theta)), theta, rtol=1e-3, atol=1e-3)
    assert torch.equal(truth.vertices(theta[:7])[3], truth.vertices(theta[3:4])[0])


def test_corresponding_meshes_give_the_modes_back(meshes):
    model = build_model(meshes)
    # Ellipsoids about one middle, by rotations alone: three numbers are all that varies.
    assert len(model.modes) == 3
    assert model.facts["compactness"][2] == pytest.approx(1, abs=1e-4)
    assert model.facts["generalisation"]["mean"][2] < 1e-3
    assert model.facts["generalisation"]["mean"][0] > 0.02
    aligned, mean = procrustes(torch.stack([mesh.vertices for mesh in meshes]))
    assert float((aligned - mean).norm(dim=2).max()) < 0.4
    smaller = build_model(meshes, scale=True)
    assert float(smaller.deviations.square().sum()) < float(model.deviations.square().sum())


def test_a_template_is_laid_onto_meshes_of_other_faces(meshes):
    model = build_model(meshes[:3], correspond=False, triangles=300, device="cpu", modes=2)
    rows = model.facts["shapes"]
    assert max(row["distance"] for row in rows) < 0.03
    assert all(row["turned"] == row["cut"] == 0 for row in rows)
    # Without rotations the shapes differ by their half-lengths, a tenth or two of a radius of one.
    assert 0.02 < float(model.deviations[0]) / len(model.mean) ** 0.5 < 0.3


@pytest.mark.parametrize("scale", [False, True])
def test_maps_have_modes_too(meshes, tmp_path, scale):
    from sdm.shapes.models.sdm_modes import build_sdm_modes

    model = build_sdm_modes(meshes[:4], resolution=20, scale=scale, device="cpu")
    model.save(tmp_path / "maps.npz")
    again = SDMModes.load(tmp_path / "maps.npz")
    assert torch.equal(again.modes, model.modes)
    assert again.map([1.0]).to_mesh().faces.shape[0] > 100
    with pytest.raises(FormatError, match="a shape model of points is needed"):
        load_family(tmp_path / "maps.npz")


def test_commands_build_and_show(meshes, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for mesh in meshes[:5]:
        save_mesh(mesh, tmp_path / f"{mesh.name}.ply")
    assert main(["shape-model", "build", ".", "-o", "balls.npz", "--device", "cpu"]) == 0
    assert "balls.npz: 3 modes of 5 shapes" in capsys.readouterr().out
    assert main(["shape-model", "show", "balls.npz", "-o", "balls.png"]) == 0
    assert "generalisation" in capsys.readouterr().out
    assert (tmp_path / "balls.png").stat().st_size > 10_000
    words = ["shape-model", "build", ".", "-o", "maps.npz", "--method", "sdm", "--resolution", "16", "--device", "cpu"]
    assert main(words) == 0
    assert main(["shape-model", "show", "maps.npz", "-o", "maps.png", "--modes", "1"]) == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("build a.ply b.ply -o m.npz", "needs three meshes or more, not 2"),
        ("build a.ply b.ply c.ply -o m.json", "does not end with .npz"),
        ("build a.ply b.ply c.ply -o m.npz --modes 3", "give 1 to 2"),
        ("build a.ply a.ply b.ply -o a.ply", "does not end with .npz"),
        ("build none.ply b.ply c.ply -o m.npz", "no mesh file none.ply"),
        ("build a.ply b.ply c.ply -o m.npz --lay --triangles 3", "100 to 200,000 are supported"),
        ("build a.ply b.ply open.ply -o m.npz --device cpu", "open.ply is not closed"),
        ("build a.ply b.ply c.ply -o m.npz --method sdm --lay", "are for models of points"),
        ("build a.ply same.ply again.ply -o m.npz", "all alike"),
        ("show a.ply -o a.png", "is not a shape model: give a file that sdm shape-model build wrote"),
        ("show junk.npz -o a.png", "is not a shape model"),
        ("show none.npz -o a.png", "cannot be read"),
    ],
)
def test_bad_input_ends_with_a_sentence(meshes, tmp_path, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(tmp_path)
    for name, mesh in zip(("a", "b", "c", "same", "again"), [*meshes[:3], meshes[0], meshes[0]], strict=True):
        save_mesh(mesh, tmp_path / f"{name}.ply")
    save_mesh(TriangleMesh(meshes[0].vertices, meshes[0].faces[1:]), tmp_path / "open.ply")
    np.savez(tmp_path / "junk.npz", values=np.zeros(3))
    assert main(["shape-model", *words.split()]) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert not (tmp_path / "m.npz").exists()


def test_arrays_that_do_not_fit_are_refused(truth):
    with pytest.raises(MeshError, match="a shape model has a mean"):
        StatisticalShape(truth.mean, truth.modes[:, :-1], truth.deviations, truth.faces)
    with pytest.raises(MeshError, match="not finite"):
        StatisticalShape(truth.mean * float("nan"), truth.modes, truth.deviations, truth.faces)
