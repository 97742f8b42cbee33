"""Free-form remainder: a sphere becomes the bumpy shape of an image, and its operators are each other's transposes."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.errors import SDMError
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.solve.free_form import _Surface, free_form
from sdm.shapes.cube_sphere import cube_surface, unit_sphere

GRID = sdm.Grid((-15.0,) * 3, (1.0,) * 3, (31, 31, 31))
CUBE, FACES = cube_surface(10)
SPHERE = torch.from_numpy(unit_sphere(CUBE)).double()


def bumpy() -> sdm.TriangleMesh:
    radius = 9.0 + 1.2 * torch.sin(3 * SPHERE[:, :1]) * torch.cos(2 * SPHERE[:, 1:2])
    return sdm.TriangleMesh((radius * SPHERE).float(), torch.from_numpy(FACES))


def ball(radius: float) -> sdm.TriangleMesh:
    return sdm.TriangleMesh((radius * SPHERE).float(), torch.from_numpy(FACES))


def distance(one: sdm.TriangleMesh, other: sdm.TriangleMesh) -> float:
    ways = [sdm.MeshIndex(a, "cpu").signed_distance(b.vertices).abs().mean() for a, b in ((one, other), (other, one))]
    return float(sum(ways) / 2)


def test_a_ball_becomes_the_shape_of_the_image():
    truth = bumpy()
    surface = _Surface(truth, torch.device("cpu"))
    share = Renderer(GRID, surface, blur=0.8, length=0.1, fine=0.5)(surface.state, derivatives=False).share
    generator = torch.Generator().manual_seed(0)
    image = 100 + 50 * share + 8 * torch.randn(share.shape, generator=generator, dtype=torch.float64)
    start = ball(8.6)
    found = free_form(image, GRID, start, blur=0.8, device="cpu")
    assert distance(start, truth) > 0.5
    assert distance(found.mesh, truth) < 0.12
    assert found.noise == pytest.approx(8, rel=0.1)
    assert (found.inside, found.outside) == (pytest.approx(150, abs=1), pytest.approx(100, abs=1))
    assert found.moved > 0.5
    assert sdm.inspect_mesh(found.mesh).outward


def test_operators_are_transposes():
    surface = _Surface(ball(9.0), torch.device("cpu"))
    renderer = Renderer(GRID, surface, blur=0.8, length=0.1, fine=0.5)
    generator = torch.Generator().manual_seed(1)
    samples = torch.randn(renderer.count, generator=generator, dtype=torch.float64)
    voxels = torch.randn(GRID.shape, generator=generator, dtype=torch.float64)
    torch.testing.assert_close((renderer.blurred(samples) * voxels).sum(), (samples * renderer.spread(voxels)).sum())
    one, other = torch.randn(2, len(SPHERE), 3, generator=generator, dtype=torch.float64)
    torch.testing.assert_close((surface.rough(one) * other).sum(), (one * surface.transposed(other)).sum())
    assert float(surface.rough(torch.ones_like(one)).abs().max()) < 1e-12


def test_what_a_vertex_does_to_a_distance():
    surface = _Surface(ball(9.0), torch.device("cpu"))
    points = torch.randn(200, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    points = points / points.norm(dim=1, keepdim=True) * torch.linspace(7.5, 10.5, 200, dtype=torch.float64)[:, None]
    before = surface.closest(points)
    amount = 1e-2 * torch.randn(len(SPHERE), generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    expected = before.values - (before.weights * amount[before.corners]).sum(1)
    surface.move(amount[:, None] * surface.normals())
    assert float((surface.closest(points).values - expected).abs().median()) < 3e-4


def test_numbers_that_make_no_sense():
    with pytest.raises(SDMError, match="roughness"):
        free_form(torch.zeros(31, 31, 31), GRID, ball(9.0), blur=0.5, roughness=0.0, device="cpu")
