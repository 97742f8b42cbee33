"""The cochlea: closed, outward, embedded, and smooth in its parameters."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import torch
import trimesh

from sdm.errors import MeshError
from sdm.shapes import Cochlea, CochleaDesign
from sdm.shapes.cochlea_reference import reference_vertices


@pytest.fixture(scope="module")
def family() -> Cochlea:
    return Cochlea()


def corners(family: Cochlea) -> torch.Tensor:
    return family.from_unit(torch.tensor(list(itertools.product((0.0, 1.0), repeat=4))))


def test_default_resolution(family):
    assert 19_000 <= len(family.faces) <= 21_000


@pytest.mark.parametrize("triangles", [500, 2_000, 77_777])
def test_resolution_is_an_option(triangles):
    family = Cochlea(triangles)
    assert abs(len(family.faces) / triangles - 1) < 0.1
    mesh = as_trimesh(family, family.vertices(family.sample(1, device="cpu"))[0])
    assert mesh.is_watertight
    assert mesh.volume > 0


@pytest.mark.parametrize("triangles", [499, 5_000_000])
def test_resolution_out_of_range(triangles):
    with pytest.raises(MeshError, match="supported"):
        Cochlea(triangles)


def test_closed_outward_and_healthy_at_the_corners(family):
    theta = corners(family)
    for row, vertices in zip(theta, family.vertices(theta), strict=True):
        mesh = as_trimesh(family, vertices)
        assert mesh.is_watertight, row
        assert mesh.is_winding_consistent, row
        assert mesh.volume > 1, row
        assert mesh.euler_number == 2, row
        angles = np.degrees(mesh.face_angles)
        assert angles.min() > 3, row
        assert np.median(angles.min(1)) > 25, row


def test_no_self_intersection(family, intersecting):
    theta = torch.cat([corners(family), family.sample(8, seed=11, device="cpu")])
    for row, vertices in zip(theta, family.vertices(theta), strict=True):
        assert intersecting(vertices, family.faces) == 0, row


def test_the_check_sees_turns_that_touch(intersecting):
    flat = Cochlea(design=CochleaDesign(rise=0.1, share=2.0))
    assert intersecting(flat.vertices(torch.tensor([[5.0, 0.0, 0.05, 0.0]]))[0], flat.faces) > 0


@pytest.fixture(scope="module")
def intersecting():
    cgal = pytest.importorskip("igl.copyleft.cgal", reason="libigl, which finds self-intersections, is not installed")

    def count(vertices: torch.Tensor, faces: torch.Tensor) -> int:
        found = cgal.remesh_self_intersections(
            vertices.double().numpy(), faces.numpy().astype(np.int64), detect_only=True
        )
        return len(found[2])

    return count


def test_kernel_is_its_reference(family):
    theta = torch.cat([corners(family), family.sample(8, seed=5, device="cpu")])
    expected = reference_vertices(theta.double(), family._tables)
    torch.testing.assert_close(family.vertices(theta).double(), expected, atol=5e-6, rtol=0)


def test_gradient_is_the_reference_gradient(family):
    theta = family.from_unit(0.02 + 0.96 * torch.rand(12, 4, generator=torch.Generator().manual_seed(2)))
    weights = torch.randn(12, 9986, 3, generator=torch.Generator().manual_seed(3))
    theta.requires_grad_()
    (family.vertices(theta) * weights).sum().backward()
    twin = theta.detach().double().requires_grad_()
    (reference_vertices(twin, family._tables) * weights).sum().backward()
    scale = twin.grad.abs().amax(0)
    assert ((theta.grad - twin.grad).abs() / scale).max() < 1e-5


def test_gradient_is_the_finite_difference(family):
    theta = torch.tensor([[3.1, 0.7, 0.12, 0.2]], requires_grad=True)
    weights = torch.randn(9986, 3, generator=torch.Generator().manual_seed(4))
    (family.vertices(theta)[0] * weights).sum().backward()
    for column, step in enumerate([1e-3, 1e-3, 1e-4, 1e-3]):
        ends = theta.detach().repeat(2, 1)
        ends[0, column] -= step
        ends[1, column] += step
        values = (family.vertices(ends).double() * weights).sum((1, 2))
        width = float(ends[1, column] - ends[0, column])
        assert theta.grad is not None
        assert float(values[1] - values[0]) / width == pytest.approx(float(theta.grad[0, column]), rel=5e-3, abs=0.5)


def test_smooth_in_theta(family):
    # The derivative has no jumps along lines through the box: its steps shrink with the steps of theta.
    def largest_jump(count: int) -> float:
        line = torch.linspace(0, 1, count, dtype=torch.float64)[:, None]
        theta = family.from_unit(torch.cat([line, 1 - line, line, line], 1).float()).double()
        points = reference_vertices(theta, family._tables)
        slope = (points[1:] - points[:-1]) * count
        return float((slope[1:] - slope[:-1]).abs().max())

    assert largest_jump(161) < 0.3 * largest_jump(41)


def test_figures_of_the_fit_are_of_this_family(family, root):
    kept = json.loads((root / "bench" / "results" / "cochlea_fit.json").read_text())
    assert kept["family"]["fingerprint"] == family.fingerprint
    assert kept["fit"]["mean_symmetric_surface_distance_mm"] <= 0.15
    sound = kept["soundness"]
    assert sound["shapes"] >= 1016
    assert sound["closed_and_oriented"]
    assert sound["self_intersecting_by_cgal"] == sound["inside_out"] == 0


def test_check_speaks_plainly(family):
    with pytest.raises(MeshError, match=r"b of theta is 0.3; cochlea takes 0.05 to 0.25 1/rad"):
        family.mesh([3.0, 0.5, 0.3, 0.0])
    with pytest.raises(MeshError, match=r"alpha of theta\[1\] is nan; cochlea takes 0 to 1.2 mm"):
        family.check([[3.0, 0.5, 0.1, 0.0], [3.0, float("nan"), 0.1, 0.0]])
    with pytest.raises(MeshError, match=r"theta has shape \(1, 3\); cochlea needs \(B, 4\)"):
        family.mesh([3.0, 0.5, 0.1])
    assert family.check(corners(family)).shape == (16, 4)


def as_trimesh(family: Cochlea, vertices: torch.Tensor) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices.numpy(), family.faces.numpy(), process=False)
