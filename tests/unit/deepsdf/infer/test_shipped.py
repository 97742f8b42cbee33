"""The model that comes with the package: a cochlea it has not seen, from all of it and from a half."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import sdm
from sdm.cli.app import main
from sdm.deepsdf import DeepSDF, decode_mesh, encode_scan, half_of
from sdm.deepsdf.samples import UnitSphere, surface_points
from sdm.shapes import Cochlea

THETA = torch.tensor([3.7, 0.45, 0.146, 0.6])


@pytest.fixture(scope="module")
def cochlea() -> sdm.TriangleMesh:
    return Cochlea(4_000).mesh(THETA)


def test_a_mesh_there_and_back(cochlea: sdm.TriangleMesh, tmp_path: Path) -> None:
    import trimesh

    trimesh.Trimesh(*cochlea.numpy(), process=False).export(tmp_path / "cochlea.ply")
    code, out = tmp_path / "cochlea.npz", tmp_path / "again.ply"
    words = ["encode", str(tmp_path / "cochlea.ply"), "-m", "cochlea", "-o", str(code), "--steps", "20"]
    assert main([*words, "--device", "cpu"]) == 0
    assert main(["decode", str(code), "-m", "cochlea", "-o", str(out), "--resolution", "32", "--device", "cpu"]) == 0
    away = sdm.signed_distance(cochlea, sdm.load_mesh(out).vertices)
    assert away.abs().mean() < 0.1


def test_the_other_half_follows(cochlea: sdm.TriangleMesh) -> None:
    points, normals = surface_points(cochlea, 1_000, seed=1)
    seen = half_of(points, torch.tensor([0.0, 1.0, 0.0]))
    model = DeepSDF.load("cochlea", "cpu")
    found = encode_scan(model, points[seen], normals[seen], sphere=UnitSphere.of(cochlea), steps=60)
    mesh = decode_mesh(model, found.code, sphere=found.sphere, resolution=32)
    away = sdm.signed_distance(mesh, points).abs()
    assert away[seen].mean() < 0.1
    assert away[~seen].mean() < 0.2
