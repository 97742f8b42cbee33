"""Meshes that float32 rounds: told of wherever no grid would."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli.app import main
from sdm.errors import SDMWarning
from sdm.inspect.rounding import lost_digits

UTM = (500_000.0, 4_500_000.0, 100.0)


def ball(at: tuple[float, float, float] = (0, 0, 0), size: float = 1.0) -> sdm.TriangleMesh:
    mesh = trimesh.creation.icosphere(3)
    return sdm.TriangleMesh(mesh.vertices * size + np.array(at), mesh.faces, "ball")


@pytest.mark.parametrize("size", [1e-20, 1e-6, 1.0, 1e8, 1e25])
def test_no_size_loses_digits_at_the_origin(size):
    assert lost_digits(ball(size=size)) == []


@pytest.mark.parametrize(
    ("at", "size", "lost"), [(UTM, 1, True), (UTM, 100, True), (UTM, 1000, False), ((9, 9, 9), 1e-5, True)]
)
def test_edges_are_compared_with_steps_of_float32(at, size, lost):
    assert bool(lost_digits(ball(at, size))) == lost


def test_a_fine_mesh_by_the_origin_is_not_said_to_be_far_away():
    mesh = trimesh.creation.icosphere(6)
    assert lost_digits(sdm.TriangleMesh(mesh.vertices, mesh.faces)) == []


def test_inspection_points_samples_and_surfaces_say_so():
    mesh = ball(UTM)
    assert sdm.inspect_mesh(mesh).problems[-1].startswith("coordinates of up to 4.5e+06 have steps of 0.5 in float32")
    points = torch.tensor(UTM) + torch.rand(20, 3)
    index = sdm.MeshIndex(ball(UTM), device="cpu")
    calls = [
        lambda: sdm.signed_distance(mesh, points, device="cpu"),
        lambda: index.signed_distance(points),
        lambda: sdm.sampling.sample(mesh, 10, device="cpu"),
        lambda: sdm.watertight(mesh, resolution=8, device="cpu"),
    ]
    for call in calls:
        with pytest.warns(SDMWarning, match="its shape has lost digits"):
            call()


def test_sampled_files_are_named(tmp_path, capsys):
    path = tmp_path / "utm.obj"
    trimesh.Trimesh(ball(UTM).vertices.double().numpy(), ball().faces.numpy(), process=False).export(path)
    words = ["sample", str(path), "-o", str(tmp_path / "out"), "--count", "50", "--open-meshes", "keep"]
    main([*words, "--skip-bad", "--orient", "keep", "--sign", "none", "--device", "cpu"])
    assert f"sdm: warning: {path}: coordinates of up to 4.5e+06" in capsys.readouterr().err
