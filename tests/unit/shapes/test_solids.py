"""Cuboids, rhomboids, ellipsoids and cylinders: volumes, topology and gradients."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh

from sdm.errors import MeshError
from sdm.shapes import Cuboid, Cylinder, Ellipsoid, Family, GeometricShapes, Rhomboid


def columns(family: Family, theta: torch.Tensor) -> dict[str, torch.Tensor]:
    return {p.name: theta[:, i].double() for i, p in enumerate(family.parameters)}


def box(c):
    return 8 * c["x"] * c["y"] * c["z"]


VOLUMES = [
    (Cuboid, box, 1e-5),
    (Rhomboid, box, 1e-5),
    (Ellipsoid, lambda c: math.pi / 6 * box(c), 4e-3),
    (Cylinder, lambda c: 2 * math.pi * c["x"] ** 2 * c["z"], 2e-3),
]


@pytest.mark.parametrize(("kind", "volume", "tolerance"), VOLUMES, ids=lambda x: getattr(x, "name", ""))
def test_volume_and_topology(kind, volume, tolerance):
    family = kind(triangles=5_000)
    theta = family.sample(8, seed=3, device="cpu")
    expected = volume(columns(family, theta))
    for i, vertices in enumerate(family.vertices(theta)):
        mesh = trimesh.Trimesh(vertices.numpy(), family.faces.numpy(), process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(float(expected[i]), rel=tolerance)
        assert np.degrees(mesh.face_angles).min() > 8


def test_the_mixture_is_made_of_its_parts():
    mixed = GeometricShapes(triangles=300, shift=0.3)
    theta = mixed.sample(64, seed=1, device="cpu")
    kinds = theta[:, 0].long()
    assert set(kinds.tolist()) == {0, 1, 2, 3}
    names = [p.name for p in mixed.parameters]
    for number, kind in enumerate((Cuboid, Rhomboid, Ellipsoid, Cylinder)):
        alone = kind(triangles=300, shift=0.3)
        rows = theta[kinds == number]
        part = rows[:, [names.index(p.name) for p in alone.parameters]]
        torch.testing.assert_close(mixed.vertices(rows), alone.vertices(part), atol=0, rtol=0)
        assert torch.equal(mixed.faces, alone.faces)


def test_the_upper_end_of_kind_is_a_cylinder():
    family = GeometricShapes(triangles=48)
    theta = family.sample(1, device="cpu")
    theta[:, 0] = 3.5
    expected = family.vertices(theta)
    theta[:, 0] = 4.0
    assert torch.equal(family.vertices(theta), expected)


def test_rotations_are_uniform():
    family = Cuboid(triangles=12)
    unit = torch.rand(20_000, 6, generator=torch.Generator().manual_seed(0))
    theta = family.from_unit(unit)
    theta[:, :3] = 0.5
    vertices = family.vertices(theta)
    # A corner goes to every direction alike, and the cube turned about it by every angle alike.
    direction = torch.nn.functional.normalize(vertices[:, 0], dim=1)
    assert direction.mean(0).abs().max() < 0.02
    assert (direction.T @ direction / len(direction) - torch.eye(3) / 3).abs().max() < 0.01
    edge = torch.nn.functional.normalize(vertices[:, 1] - vertices[:, 0], dim=1)
    assert (edge.T @ edge / len(edge) - torch.eye(3) / 3).abs().max() < 0.01


def test_gradient_is_the_finite_difference():
    family = GeometricShapes(triangles=108, shift=0.4)
    theta = family.from_unit(0.1 + 0.8 * family.to_unit(family.sample(8, seed=6, device="cpu")))
    theta[:, 0] = torch.arange(8) % 4 + 0.5
    vertices = family.vertices(theta)
    weights = torch.randn(vertices.shape, generator=torch.Generator().manual_seed(7))
    theta.requires_grad_()
    (family.vertices(theta) * weights).sum().backward()
    for column in range(1, theta.shape[1]):
        ends = theta.detach().clone(), theta.detach().clone()
        ends[0][:, column] -= 1e-3
        ends[1][:, column] += 1e-3
        low, high = ((family.vertices(e).double() * weights).sum((1, 2)) for e in ends)
        slope = (high - low) / (ends[1] - ends[0])[:, column].double()
        assert theta.grad is not None
        torch.testing.assert_close(slope.float(), theta.grad[:, column], atol=0.1, rtol=5e-3)


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize("kind", [Cuboid, Rhomboid, Ellipsoid, Cylinder, GeometricShapes])
def test_bounds_hold_every_shape_and_little_more(kind, shift):
    family = kind(triangles=300, shift=shift)
    theta = family.sample(20_000, seed=2, device="cpu")
    # The largest, turned at random.
    for column, p in enumerate(family.parameters):
        if p.name == "kind":
            theta[:, column] = 1.5
        elif p.name not in ("u1", "u2", "u3"):
            theta[:, column] = p.high
    vertices = torch.cat([family.vertices(part).amax((0, 1))[None] for part in theta.split(1000)]).amax(0)
    low, high = family.bounds()
    assert torch.equal(low, -high)
    assert bool((vertices <= high).all())
    assert bool((vertices > 0.99 * high).all())


@pytest.mark.parametrize(
    "arguments", [{"sizes": (0, 1)}, {"sizes": (2, 1)}, {"shear": 0}, {"triangles": 3}, {"shift": -1}]
)
def test_senseless_options(arguments):
    with pytest.raises(MeshError):
        GeometricShapes(**arguments)
