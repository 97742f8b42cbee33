"""Closed surfaces of open, turned, crossing and hidden parts, and how far they are from the meshes."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch

import sdm
from sdm.core.mesh import TriangleMesh
from sdm.errors import GridError, MeshError, SDMError
from sdm.remeshing import closing_field
from sdm.remeshing.beads import without_beads
from sdm.remeshing.watertight import closedness
from tests.helpers.closed_surface import areas_and_volume, assert_closed_manifold


@pytest.fixture(autouse=True)
def few_samples(monkeypatch):
    """For distances of two surfaces: still several for each of their triangles."""
    monkeypatch.setattr(sys.modules["sdm.remeshing.watertight"], "SAMPLES", 20_000)


@cache
def ball() -> tuple[np.ndarray, np.ndarray]:
    grid = sdm.Grid((-1.2,) * 3, (0.2,) * 3, (13,) * 3)
    return sdm.SDM(grid.points().norm(dim=-1) - 1, grid).to_mesh().numpy()


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> TriangleMesh:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)])
    return TriangleMesh(np.concatenate([vertices for vertices, _ in parts]), faces, "parts")


def half() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = ball()
    return vertices, faces[(vertices[faces][:, :, 2] > -0.01).all(1)]


def test_a_closed_mesh_comes_back_within_half_a_voxel():
    mesh = joined(ball())
    surface, report = sdm.watertight(mesh, 40, return_report=True)
    assert_closed_manifold(surface)
    assert (report.closed, report.offset, report.sign) == (True, 0.0, "flood")
    assert report.input_to_output.largest < 0.5 * report.spacing
    assert report.output_to_input.largest < 0.5 * report.spacing
    assert areas_and_volume(surface)[1] == pytest.approx(areas_and_volume(mesh)[1], rel=5e-3)
    assert torch.equal(sdm.watertight(mesh, 40).vertices, surface.vertices)


def test_half_spheres_become_closed_shells():
    """Of a hundred, half of them inside out, each is a plate of its own; the wide opening is not filled."""
    vertices, faces = half()
    parts = [(np.add(vertices, [3 * (n % 10), 3 * (n // 10), 0]), faces[:, :: (-1) ** n]) for n in range(100)]
    mesh = joined(*parts)
    surface, report = sdm.watertight(mesh, 160, return_report=True)
    assert_closed_manifold(surface)
    found = sdm.inspect_mesh(surface)
    assert (found.components, found.closed, found.outward) == (100, True, True)
    assert not report.closed
    # A plate as thick as twice the offset.
    area = areas_and_volume(mesh)[0].sum()
    assert areas_and_volume(surface)[1] == pytest.approx(2 * report.offset * area, rel=0.3)
    assert report.input_to_output.largest < 0.87 * report.spacing


def test_no_beads_beside_the_rims_of_half_spheres():
    """A voxel near a corner of a rim may be alone, and is dropped; of a part that is all beads nothing is."""
    vertices, faces = half()
    rng, parts = np.random.default_rng(19), []
    for n in range(8):
        parts.append((vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + np.array([3 * n, 0, 0]), faces))
    tiny = np.array([[0, 3, 0], [0.01, 3, 0], [0, 3.01, 0.01]])
    mesh = joined(*parts, (tiny, np.array([[0, 1, 2]])))
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    # The small triangle is at a voxel, and all that is left of it is one.
    grid = sdm.Grid((-1.5,) * 3, (0.15,) * 3, (161, 40, 21))
    plates = index.signed_distance_map(grid, sign="none").to_mesh(0.505 * 0.15)
    beads = sdm.inspect_mesh(plates).components
    surface = without_beads(plates, index)
    assert_closed_manifold(surface)
    assert sdm.inspect_mesh(surface).components == 9 < beads
    assert len(without_beads(surface, index)) == len(surface)


def test_a_small_hole_is_closed_and_filled():
    vertices, faces = ball()
    holed = TriangleMesh(vertices, faces[1:], "holed")
    surface, report = sdm.watertight(holed, 30, hole_size=0.5, return_report=True)
    assert_closed_manifold(surface)
    assert (report.closed, report.hole_size) == (False, 0.5)
    assert areas_and_volume(surface)[1] > areas_and_volume(joined(ball()))[1]


def test_crossing_parts_become_their_union():
    vertices, faces = ball()
    surface = sdm.watertight(joined((vertices, faces), (np.add(vertices, [1, 0, 0]), faces[:, ::-1])), 40)
    assert_closed_manifold(surface)
    assert sdm.inspect_mesh(surface).components == 1
    whole, lens = 4 / 3 * np.pi, 5 / 12 * np.pi
    assert areas_and_volume(surface)[1] == pytest.approx(2 * whole - lens, rel=0.05)


@pytest.mark.parametrize(("hidden", "share"), [("drop", 1.0), ("keep", 1 - 0.5**3)])
def test_hidden_cavities_are_dropped_or_kept(hidden, share):
    vertices, faces = ball()
    surface, report = sdm.watertight(
        joined((vertices, faces), (vertices / 2, faces[:, ::-1])), 40, hidden=hidden, return_report=True
    )
    assert_closed_manifold(surface)
    assert areas_and_volume(surface)[1] == pytest.approx(share * areas_and_volume(joined(ball()))[1], rel=0.01)
    # What was dropped is far from the surface, and the report says so.
    assert (report.input_to_output.largest > 0.4) == (hidden == "drop")


def test_a_cavity_is_kept_of_what_is_inside_out():
    vertices, faces = ball()
    hollow = joined((vertices, faces), (vertices / 2, faces[:, ::-1]))
    expected = sdm.watertight(hollow, 40, hidden="keep")
    found = sdm.watertight(hollow.flipped(), 40, hidden="keep")
    assert torch.equal(found.vertices, expected.vertices)
    assert torch.equal(found.faces, expected.faces)
    # Nor is one of two parts lost.
    parts = joined((vertices, faces), (np.add(vertices, [3, 0, 0]), faces[:, ::-1]))
    assert sdm.inspect_mesh(sdm.watertight(parts, 40, hidden="keep")).components == 2


def test_an_open_shell_with_a_hidden_inside_keeps_its_hollow():
    vertices, faces = ball()
    mesh = TriangleMesh(vertices, faces[1:], "holed")
    filled, hollow = sdm.watertight(mesh, 30, hole_size=0.5), sdm.watertight(mesh, 30, hidden="keep")
    assert_closed_manifold(hollow)
    assert areas_and_volume(hollow)[1] < 0.5 * areas_and_volume(filled)[1]


def test_a_closed_mesh_whose_faces_disagree_keeps_its_hollow():
    """It has no sign then, and at an offset of 0 nothing was found of it."""
    vertices, faces = ball()
    turned = np.concatenate([faces[:5, ::-1], faces[5:]])
    surface, report = sdm.watertight(TriangleMesh(vertices, turned), 30, hidden="keep", return_report=True)
    assert_closed_manifold(surface)
    assert report.offset == pytest.approx(report.spacing / 2, rel=0.02)
    assert report.input_to_output.largest < report.spacing


def test_a_sheet_midway_between_voxels_becomes_a_plate():
    """Also one that is there twice, whose every edge has two faces."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for several in (faces, np.concatenate([faces, faces[:, ::-1]])):
        surface = sdm.watertight(TriangleMesh(square, several), 20)
        assert_closed_manifold(surface)
        assert sdm.inspect_mesh(surface).components == 1


def test_wires_survive_an_offset_of_half_a_diagonal():
    line = np.array([[0, 0, 0], [1, 0.3, 0.2], [0.5, 0.15, 0.1]], np.float32)
    mesh = TriangleMesh(line, np.array([[0, 1, 2]]))
    surface, report = sdm.watertight(mesh, 30, offset=0.04, return_report=True)
    assert report.offset > 0.87 * report.spacing
    assert_closed_manifold(surface)
    assert sdm.inspect_mesh(surface).components == 1


@pytest.mark.parametrize("case", ["closed", "half, filled", "half, open", "parts", "keep", "dual"])
def test_bands_give_the_surface_of_the_map(case, monkeypatch):
    """Vertex for vertex, also across an opening that the flood does not pass."""
    vertices, faces = ball()
    mesh, options = joined(half()), dict[str, Any]()
    if case == "closed":
        mesh = joined(ball())
    elif case == "half, filled":
        # The rim is no circle: about 2 across.
        options = {"hole_size": 2.1}
    elif case == "parts":
        mesh = joined((vertices, faces), (np.add(vertices, [1, 0, 0]), faces[:, ::-1]), (vertices / 3, faces[3:]))
    elif case == "keep":
        mesh, options = joined((vertices, faces), (vertices / 2, faces[:, ::-1])), {"hidden": "keep"}
    elif case == "dual":
        options = {"method": "dual"}
    dense = sdm.watertight(mesh, 64, device="cpu", **options)
    monkeypatch.setattr(closing_field, "LARGEST_MAP", 0)
    monkeypatch.setattr(closing_field, "SHARE", 0)
    banded = sdm.watertight(mesh, 64, device="cpu", **options)
    assert_closed_manifold(banded)
    assert torch.equal(banded.faces, dense.faces)
    assert torch.equal(banded.vertices, dense.vertices)


def test_of_a_mesh_far_inside_its_surface_fewer_points_are_taken():
    """All of that surface is nearly as far from each of them, so that each would look at every triangle."""
    mesh = joined(half())
    reports = [sdm.watertight(mesh, 20, offset=offset, return_report=True)[1] for offset in (0.1, 15.0)]
    near, far = (report.input_to_output for report in reports)
    assert far.points < near.points / 10
    assert far.largest == pytest.approx(15, rel=0.01)


def test_options_that_make_no_sense():
    mesh = joined(half())
    with pytest.raises(SDMError, match="use 'drop' or 'keep'"):
        sdm.watertight(mesh, 20, hidden="lose")
    with pytest.raises(SDMError, match="offset is -1"):
        sdm.watertight(mesh, 20, offset=-1)
    for odd in ("1", True, np.array([1.0, 2.0])):
        with pytest.raises(SDMError, match="give a length of at least 0"):
            sdm.watertight(mesh, 20, offset=odd)  # pyright: ignore[reportArgumentType, reportCallIssue]
    with pytest.raises(SDMError, match=r"so far out every mesh is a ball; give at most [0-9.]+, in the mesh's unit"):
        sdm.watertight(mesh, 20, offset=1e9)
    with pytest.raises(SDMError, match="hole_size is -1"):
        sdm.watertight(mesh, 20, hole_size=-1)
    with pytest.raises(SDMError, match="hole_size is the width of gaps"):
        sdm.watertight(mesh, 20, hole_size=1, hidden="keep")
    with pytest.raises(GridError, match="resolution 4 is too low"):
        sdm.watertight(mesh, 4)
    with pytest.raises(GridError, match="GiB"):
        sdm.watertight(mesh, 20_000, hole_size=1.0)
    with pytest.raises(SDMError, match="as thick as a voxel"):
        sdm.watertight(mesh, 20, offset=0)
    with pytest.raises(MeshError, match="size zero"):
        sdm.watertight(TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), 20)


@pytest.mark.gpu
def test_a_gpu_gives_the_same_surface():
    mesh = joined(half())
    host, there = (sdm.watertight(mesh, 60, device=device) for device in ("cpu", "cuda"))
    assert torch.equal(host.faces, there.faces.cpu())
    torch.testing.assert_close(host.vertices, there.vertices.cpu(), rtol=1e-5, atol=1e-5)


def test_most_closed_meshes_are_told_by_a_look_at_their_edges(monkeypatch):
    """And the others as `inspect_mesh` has it."""
    vertices, faces = ball()
    closed = sdm.TriangleMesh(vertices, faces)
    twice = sdm.TriangleMesh(np.concatenate([vertices, vertices]), np.concatenate([faces, faces + len(vertices)]))
    doubled = sdm.TriangleMesh(vertices, np.concatenate([faces, faces[:, ::-1]]))
    turned = sdm.TriangleMesh(vertices, np.concatenate([faces[1:], faces[:1, ::-1]]))
    opened = sdm.TriangleMesh(vertices, faces[1:])
    for mesh in (closed, closed.flipped(), twice, doubled, turned, opened):
        found = sdm.inspect_mesh(mesh)
        assert closedness(mesh) == (found.watertight and found.duplicate_faces == 0, found.closed)
    monkeypatch.setattr(sys.modules["sdm.remeshing.watertight"], "inspect_mesh", None)
    assert closedness(closed) == (True, True)
