"""Normalisation into the unit sphere, and back."""

from __future__ import annotations

import pytest
import torch

from sdm import MeshError, TriangleMesh
from sdm.deepsdf.samples import UnitSphere


def test_the_sphere_is_around_the_middle_of_the_box_with_room() -> None:
    sphere = UnitSphere.of(torch.tensor([[0.0, 0, 0], [4, 0, 0], [0, 2, 0]]))
    assert sphere.centre == (2.0, 1.0, 0.0)
    assert sphere.radius == pytest.approx(1.03 * 5**0.5)


def test_vertices_that_no_face_uses_do_not_count() -> None:
    mesh = TriangleMesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [99, 99, 99]], [[0, 1, 2]])
    assert UnitSphere.of(mesh).centre == (1.0, 1.0, 0.0)


def test_there_and_back_keeps_every_coordinate_far_from_the_origin() -> None:
    points = torch.rand(1000, 3) * 100 + torch.tensor([1e4, -1e4, 0])
    sphere = UnitSphere.of(points)
    unit = sphere.to_unit(points)
    assert unit.norm(dim=1).max() == pytest.approx(1 / 1.03, rel=1e-6)
    # The unit sphere's float32 times the radius, and the coordinates' own.
    assert (sphere.from_unit(unit) - points).abs().max() <= 1e4 * 2.0**-23


def test_normalised_meshes_are_points_of_the_unit_sphere_and_back() -> None:
    mesh = TriangleMesh([[1, 2, 3], [4, 2, 3], [1, 7, 3]], [[0, 1, 2]], "it")
    sphere = UnitSphere.of(mesh)
    unit = sphere.normalised(mesh)
    assert torch.allclose(sphere.from_unit(unit.vertices), mesh.vertices, atol=1e-6)
    assert unit.name == "it"


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
def test_a_sphere_without_a_radius_is_said(radius: float) -> None:
    with pytest.raises(MeshError, match="cannot normalise a shape"):
        UnitSphere((0.0, 0.0, 0.0), radius)
