"""Shape models of other tools: GIAS's principal components, and the bones of articulated-ssm where it is installed."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.cli import main
from sdm.errors import FormatError
from sdm.shapes import load_family
from sdm.shapes.models.gias_model import read_gias_model


def two_spheres() -> sdm.TriangleMesh:
    vertices, faces = (np.asarray(x) for x in sphere(4))
    moved = vertices + np.array([5, 0, 0])
    return sdm.TriangleMesh(np.concatenate([vertices, moved]), np.concatenate([faces, faces + len(vertices)]))


@pytest.fixture
def model(tmp_path):
    """A file of three modes, with an array of objects in it, and the mesh of its mean."""
    mesh = two_spheres()
    mean = mesh.vertices.numpy().astype(np.float64).ravel()
    modes = np.linalg.qr(np.random.default_rng(0).normal(size=(mean.size, 3)))[0]
    objects = np.array([None], dtype=object)
    path = tmp_path / "two.pc.npz"
    np.savez(path, mean=mean, modes=modes, weights=np.array([4.0, 1.0, 0.25]), SD=objects)
    mesh.save(tmp_path / "mean.ply")
    return path


def test_the_whole_varies_as_the_file_says(model):
    found = read_gias_model(model, two_spheres())
    with np.load(model) as arrays:
        wanted = arrays["mean"] + arrays["modes"] @ (np.sqrt(arrays["weights"]) * [1, -2, 0.5])
    # A mode's sign is free.
    signs = torch.sign((found.modes.reshape(3, -1) @ torch.from_numpy(np.load(model)["modes"]).float()).diagonal())
    theta = torch.tensor([[1.0, -2.0, 0.5]]) * signs
    np.testing.assert_allclose(found.vertices(theta)[0].numpy().ravel(), wanted, atol=1e-6)
    np.testing.assert_allclose(found.deviations, [2, 1, 0.5], rtol=1e-6)
    assert found.facts["compactness"][-1] == pytest.approx(1)


def test_a_part_varies_as_it_does_in_the_whole(model):
    whole, half = two_spheres(), len(two_spheres().vertices) // 2
    part = read_gias_model(model, whole, vertices=slice(half, 2 * half))
    flat = part.modes.reshape(len(part.modes), -1).double()
    torch.testing.assert_close(flat @ flat.T, torch.eye(len(flat), dtype=torch.float64), atol=1e-6, rtol=0)
    scaled = flat * part.deviations.double()[:, None]
    with np.load(model) as arrays:
        own = (arrays["modes"] * np.sqrt(arrays["weights"]))[3 * half :]
    np.testing.assert_allclose(scaled.T @ scaled, own @ own.T, atol=1e-6)
    assert len(part.triangles) == len(whole.faces) // 2
    assert int(part.triangles.max()) == half - 1


def test_the_command_makes_a_family(model, tmp_path, capsys):
    half = len(two_spheres().vertices) // 2
    words = ["shape-model", "import", str(model), "--mean", str(tmp_path / "mean.ply"), "-o", str(tmp_path / "m.npz")]
    assert main([*words, "--vertices", f"0:{half}"]) == 0
    assert f"{half} vertices" in capsys.readouterr().out
    mesh = load_family(tmp_path / "m.npz").mesh([0.0, 0.0, 0.0])
    assert sdm.inspect_mesh(mesh).closed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"weights": [4.0, -1.0, 0.2]}, "variance below zero"),
        ({"weights": [4.0, 1.0]}, "is not a GIAS shape model"),
        ({"mean": np.array(["a"], dtype=object)}, "is not a GIAS shape model"),
        ({"mean": None}, "is not a GIAS shape model"),
    ],
)
def test_other_files_are_refused(change, words, model, tmp_path):
    with np.load(model, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in ("mean", "weights", "modes")} | change
    path = tmp_path / "other.npz"
    np.savez(path, **{name: np.asarray(value) for name, value in arrays.items() if value is not None})
    with pytest.raises(FormatError, match=words):
        read_gias_model(path, two_spheres())


def test_other_meshes_and_ranges_are_refused(model, tmp_path, capsys):
    with pytest.raises(FormatError, match="give the mesh that belongs to it"):
        read_gias_model(model, sdm.TriangleMesh(*sphere(4)))
    with pytest.raises(FormatError, match="at least four"):
        read_gias_model(model, two_spheres(), vertices=slice(9, 3))
    words = ["shape-model", "import", str(model), "--mean", str(tmp_path / "mean.ply"), "-o", str(tmp_path / "m.npz")]
    assert main([*words, "--vertices", "all"]) == 2
    assert "give FIRST:END" in capsys.readouterr().err


def test_bones_of_articulated_ssm():
    found = importlib.util.find_spec("articulated_ssm_both_sides")
    if found is None or found.origin is None:
        pytest.skip("needs articulated-ssm")
    folder = Path(found.origin).parent / "coupled_ssm" / "pel_fem_tib_fib_both_side"
    mean = sdm.load_mesh(folder / "shape_model_left_side_mean.ply")
    femur = read_gias_model(folder / "shape_model_left_side.pc.npz", mean, vertices=slice(9366, 14482))
    assert sdm.inspect_mesh(femur.mesh([0.0] * len(femur.parameters))).closed
