from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError
from sdm.viz import picture
from sdm.viz.figure import colour_limit, line_step

TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def ball(origin=(-1.5, -1.5, -1.5), spacing=(0.25, 0.25, 0.25), shape=(13, 13, 13), direction=np.eye(3)) -> SDM:
    grid = Grid(direction @ np.asarray(origin), spacing, shape, direction)
    return SDM(grid.points().norm(dim=-1) - 1, grid)


def filled(value: float) -> SDM:
    return SDM(torch.full((4, 4, 4), value), Grid((0, 0, 0), (1, 1, 1), (4, 4, 4)))


def partly_infinite() -> SDM:
    field = ball()
    field.values[0] = torch.inf
    field.values[1, 0] = torch.nan
    return field


FIELDS = {
    "ball": ball(),
    "turned": ball(direction=TURN),
    "flat voxels": ball((-1.5, -1.4, -1.2), (0.1, 0.2, 0.6), (31, 15, 5)),
    "outside": ball(origin=(2, 2, 2)),
    "inside": ball(spacing=(0.01, 0.01, 0.01), origin=(0, 0, 0)),
    "one voxel thin": ball((-1.5, -1.5, 0), shape=(13, 13, 1)),
    "a line": ball((-1.5, 0, 0), shape=(13, 1, 1)),
    "one voxel": ball((0, 0, 0), shape=(1, 1, 1)),
    "zero": filled(0.0),
    "nan": filled(float("nan")),
    "partly infinite": partly_infinite(),
}


@pytest.mark.parametrize("name", FIELDS)
def test_any_map_is_drawn_without_a_warning(name, tmp_path):
    from PIL import Image

    target = tmp_path / "map.png"
    picture(FIELDS[name], target, title=name, unit="mm", facts={"mesh": "ball"}, dpi=30)
    with Image.open(target) as image:
        assert image.size == (400, 225)
        pixels = np.asarray(image.convert("RGB"))
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
    assert [path.name for path in tmp_path.iterdir()] == ["map.png"]


def test_inside_is_red_and_outside_is_blue(tmp_path):
    from PIL import Image

    target = tmp_path / "map.png"
    picture(FIELDS["inside"], target, dpi=30)
    red, _, blue = np.asarray(Image.open(target).convert("RGB"))[60, 320].astype(int)
    assert red > blue + 50
    picture(FIELDS["outside"], target, dpi=30)
    red, _, blue = np.asarray(Image.open(target).convert("RGB"))[60, 320].astype(int)
    assert blue > red + 50


@pytest.mark.parametrize(
    ("low", "high", "limit", "extend"),
    [(-1, 1.5, 1.5, "neither"), (-1, 9, 2, "max"), (1, 3, 3, "neither"), (-3, -1, 3, "neither"), (0, 0, 1, "neither")],
)
def test_colours_end_at_twice_the_depth(low, high, limit, extend):
    assert colour_limit(np.array([low, high], dtype=float)) == (limit, extend)


@pytest.mark.parametrize(("limit", "step"), [(1.5, 0.5), (3.0, 1.0), (2.9, 0.5), (60.0, 20.0), (0.003, 0.001)])
def test_lines_are_at_round_distances(limit, step):
    assert line_step(limit) == pytest.approx(step)


def test_leaves_pyplot_alone(tmp_path):
    before = "matplotlib.pyplot" in sys.modules
    picture(filled(1.0), tmp_path / "map.svg", dpi=30)
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_a_wrong_ending_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"map\.xyz does not end like a picture"):
        picture(filled(1.0), tmp_path / "map.xyz")


def test_a_folder_that_is_not_there_is_said(tmp_path):
    with pytest.raises(FormatError, match="cannot be written"):
        picture(filled(1.0), tmp_path / "nowhere" / "map.png", dpi=30)


def test_an_interrupted_write_leaves_the_old_picture(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    target = tmp_path / "map.png"
    target.write_bytes(b"old")

    def stop(self, path, **options):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", stop)
    with pytest.raises(KeyboardInterrupt):
        picture(filled(1.0), target)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]
