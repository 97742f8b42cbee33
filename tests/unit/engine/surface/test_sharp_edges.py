"""Edges that one vertex in a cell cannot keep: those of steps of less than a voxel, which share cells."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.engine.surface import dual_contouring
from sdm.engine.surface.sharp_edges import edge_points
from tests.helpers.closed_surface import areas_and_volume, assert_closed_manifold

TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]


def stairs(height: float) -> TriangleMesh:
    """A turned bar of width 1 whose upper side has a step of that height."""
    outline = np.array([(0, 0), (1, 0), (1, 0.5 + height), (0.5, 0.5 + height), (0.5, 0.5), (0, 0.5)])
    vertices = np.concatenate([np.pad(outline, ((0, 0), (0, 1)), constant_values=z) for z in (0.0, 1.0)])
    below = [(0, 5, 4), (0, 4, 1), (1, 4, 2), (2, 4, 3)]
    faces = below + [(a + 6, c + 6, b + 6) for a, b, c in below]
    for a in range(6):
        b = (a + 1) % 6
        faces += [(a, b, b + 6), (a, b + 6, a + 6)]
    mesh = TriangleMesh(vertices @ TURN.T, np.array(faces), "stairs")
    return mesh if areas_and_volume(mesh)[1] > 0 else mesh.flipped()


def apart(surface: TriangleMesh, mesh: TriangleMesh, step: float) -> float:
    """The largest distance of points of the mesh's sharp edges from a surface, in voxels."""
    points = edge_points(mesh, 0.03 * step).points
    return float(sdm.signed_distance(surface, points, sign="none").max()) / step


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8, 1.1])
@pytest.mark.parametrize("resolution", [17, 24])
def test_both_edges_of_a_low_step_are_kept(share, resolution):
    step = float(sdm.Grid.around(stairs(0.1), resolution, margin=0.2).spacing[0])
    mesh = stairs(share * step)
    grid = sdm.Grid.around(mesh, resolution, margin=0.2)
    surface = sdm.signed_distance_map(mesh, grid).to_mesh(method="dual", mesh=mesh)
    assert_closed_manifold(surface)
    assert apart(surface, mesh, grid.spacing[0]) < 0.05
    assert areas_and_volume(surface)[1] == pytest.approx(areas_and_volume(mesh)[1], rel=2e-3)
    away = sdm.signed_distance(mesh, surface.vertices, sign="none")
    assert float(away.max()) < 0.5 * grid.spacing[0]


def test_a_cube_is_left_as_it_is():
    """Nothing is added where one vertex in a cell keeps all edges."""
    mesh = stairs(0.25)
    grid = sdm.Grid.around(mesh, 40, margin=0.2)
    field = sdm.signed_distance_map(mesh, grid)
    assert len(field.to_mesh(method="dual", mesh=mesh)) == len(field.to_mesh(method="dual"))


def test_edges_that_are_hidden_inside_draw_nothing_in(monkeypatch):
    """A bar half a voxel beneath the surface of a larger one."""
    outer = stairs(0.25)
    step = 1.4 / 24
    inner = outer.vertices.double() @ torch.from_numpy(TURN)
    low, high = inner.amin(0), inner.amax(0)
    inner = low + 0.5 * step + (inner - low) * ((high - low - step) / (high - low))
    both = TriangleMesh(
        torch.cat([outer.vertices, (inner @ torch.from_numpy(TURN).T).float()]),
        torch.cat([outer.faces, outer.faces + len(outer.vertices)]),
        "nested",
    )
    field = sdm.signed_distance_map(both, sdm.Grid.around(both, 24, margin=0.2))
    found = field.to_mesh(method="dual", mesh=both)
    monkeypatch.setattr(dual_contouring, "with_sharp_edges", lambda surface, *_: surface)
    plain = field.to_mesh(method="dual", mesh=both)
    assert_closed_manifold(found)
    added = found.vertices[len(plain.vertices) :]
    assert len(added) > 0
    assert float(sdm.signed_distance(outer, added, sign="none").max()) < 1e-6


def test_edges_of_a_mesh():
    """Those of a bar, not its diagonals; and none twice where its faces do not agree which side is out."""
    mesh = stairs(0.25)
    points, ways = edge_points(mesh, 0.01)
    back = points.double().numpy() @ TURN
    assert len(points) > 18 / 0.02
    outline = np.array([0, 0.5, 1.0])
    on = np.stack([np.abs(back[:, k, None] - np.append(outline, 0.75)).min(1) < 1e-6 for k in range(3)])
    assert (on.sum(0) >= 2).all()
    assert torch.allclose(ways.norm(dim=1), torch.ones(len(ways), dtype=torch.float64))
    turned = TriangleMesh(mesh.vertices, torch.cat([mesh.faces[:5].flip(1), mesh.faces[5:]]), check=False)
    assert len(edge_points(turned, 0.01).points) == len(points)


@pytest.mark.parametrize(("degrees", "sharp"), [(29.9, False), (30.001, True), (31.0, True)])
def test_an_edge_is_sharp_from_30_degrees_on(degrees, sharp):
    turn = np.radians(degrees)
    vertices = np.array([(0, 0, 0), (0, 1, 0), (-1, 0.5, 0), (np.cos(turn), 0.5, np.sin(turn))])
    mesh = TriangleMesh(vertices, np.array([(0, 1, 2), (1, 0, 3)]), check=False)
    assert bool(len(edge_points(mesh, 0.1).points)) == sharp
