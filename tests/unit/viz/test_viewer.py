"""Views: what is drawn, where things are in it, and what is refused."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

import sdm
from sdm.cli import main
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import FormatError, SDMError
from sdm.viz.viewer import distance_to_see, view

TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def ball(direction=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))) -> sdm.SDM:
    grid = sdm.Grid((3.0, -2.0, 5.0), (0.25, 0.5, 0.25), (17, 9, 17), direction)
    middle = torch.tensor(grid.affine[:3, :3] @ np.array([8.0, 4.0, 8.0]) + grid.affine[:3, 3], dtype=torch.float32)
    return sdm.SDM((grid.points().reshape(*grid.shape, 3) - middle).norm(dim=-1) - 1.2, grid)


@pytest.fixture
def opengl():
    """Skips where Polyscope is not installed, or has no OpenGL to draw with."""
    polyscope = pytest.importorskip("polyscope")
    polyscope.set_verbosity(0)
    # As `sdm view` does, else it writes files where the tests run.
    polyscope.set_use_prefs_file(False)
    polyscope.set_allow_headless_backends(True)
    try:
        polyscope.init()
    except RuntimeError:
        pytest.skip("there is no OpenGL here")
    return polyscope


@pytest.mark.parametrize("direction", [((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), TURNED])
def test_a_picture_has_surface_and_map_in_their_colours(opengl, tmp_path, direction):
    from matplotlib.image import imread

    view(ball(direction), picture=tmp_path / "view.png")
    pixels = imread(tmp_path / "view.png")[..., :3]
    red, green, blue = np.moveaxis(pixels, -1, 0)
    shares = [float(mask.mean()) for mask in (red > green + 0.2, blue > red + 0.1)]
    # A ball of 1.2 in a block of 4: the surface before the map, which is blue outside.
    assert 0.01 < shares[0] < 0.3
    assert shares[1] > 0.05
    rows, columns = np.nonzero(red > green + 0.2)
    # Looked at, so in the middle.
    assert abs(rows.mean() / len(pixels) - 0.5) < 0.1
    assert abs(columns.mean() / pixels.shape[1] - 0.5) < 0.1


@pytest.mark.parametrize("towards", [(0.3, -0.8, 0.5), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)])
def test_all_places_are_in_the_picture_and_one_of_them_near_its_edge(towards):
    places = np.random.default_rng(0).normal(size=(50, 3)) * (1, 2, 5)
    towards = np.array(towards) / np.linalg.norm(towards)
    depth = distance_to_see(places, towards) - places @ towards
    right = np.cross((0, 0, 1), towards) if abs(towards[2]) < 1 else np.array([1.0, 0, 0])
    right /= np.linalg.norm(right)
    shares = np.abs([places @ right / depth / 1.6, places @ np.cross(towards, right) / depth]) / np.tan(np.pi / 8)
    assert depth.min() > 0
    assert 0.9 < shares.max() < 0.92


def test_a_surface_up_to_the_border_of_a_tall_map_is_not_cut_off(opengl, tmp_path):
    from matplotlib.image import imread

    grid = sdm.Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (16, 16, 48))
    across = (grid.points().reshape(*grid.shape, 3)[..., :2] - 7.5).norm(dim=-1)
    view(sdm.SDM(across - 7.0, grid), picture=tmp_path / "view.png")
    pixels = imread(tmp_path / "view.png")[..., :3]
    assert (np.concatenate([pixels[:5], pixels[-5:]]) > 0.95).all()


def test_the_block_lies_where_the_grid_does(opengl, tmp_path):
    field = ball(TURNED)
    view(field, picture=tmp_path / "view.png")
    shown = opengl.get_volume_grid("map")
    corner = shown.get_transform() @ [*shown.get_bound_max(), 1.0]
    last = field.grid.affine @ [16.0, 8.0, 16.0, 1.0]
    np.testing.assert_allclose(corner, last, atol=1e-5)
    assert tuple(shown.get_grid_node_dim()) == field.grid.shape


def test_the_command_shows_maps_and_meshes(opengl, tmp_path, capsys):
    import trimesh

    ball().save(tmp_path / "ball.npz")
    mesh = demo_mesh(rings=21, segments=12)
    trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy(), process=False).export(tmp_path / "demo.ply")
    for words in (["ball.npz", "--level", "0.3"], ["demo.ply", "--resolution", "24", "--device", "cpu"]):
        target = tmp_path / f"{words[0]}.png"
        assert main(["view", str(tmp_path / words[0]), *words[1:], "--out", str(target)]) == 0
        assert target.read_bytes().startswith(b"\x89PNG")
    labels = sdm.SDM(torch.ones(4, 4, 4), sdm.Grid((0, 0, 0), (1, 1, 1), (4, 4, 4)))
    labels.save(tmp_path / "labels.npz")
    assert main(["view", str(tmp_path / "labels.npz"), "--out", str(tmp_path / "no.png")]) == 2
    assert "labels.npz looks like a label volume: sdm edt" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "ball.npz"), "--level", "9", "--out", str(tmp_path / "no.png")]) == 2
    assert "no surface at level 9" in capsys.readouterr().err
    assert not (tmp_path / "no.png").exists()


def test_what_cannot_be_shown_is_said(tmp_path, monkeypatch):
    with pytest.raises(FormatError, match=r"does not end in \.png"):
        view(ball(), picture=tmp_path / "view.jpg")
    pytest.importorskip("polyscope")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SDMError, match="no display"):
        view(ball())


def test_polyscope_is_asked_for_where_it_is_not_installed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "polyscope", None)
    with pytest.raises(SDMError, match="viewer"):
        view(ball(), picture=tmp_path / "view.png")
