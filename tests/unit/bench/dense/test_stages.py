"""The picture of the stages shows what is true: no list lacks the nearest segment of any pixel."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.dense import stages as stages
from sdm.bench.dense import stages_figure


def nearest(points, segments):
    return np.array([np.linalg.norm(stages.closest_points(p, segments) - p, axis=1).min() for p in points])


def pixels_of(box, edge):
    offsets = np.linspace(-1, 1, edge)
    return box.centre + np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2) * box.half


@pytest.mark.parametrize("seed", range(6))
def test_lists_hold_the_nearest(seed):
    rng = np.random.default_rng(seed)
    segments = rng.uniform(-1, 1, (60, 1, 2)) + rng.normal(size=(60, 2, 2)) * rng.choice([0.01, 0.2, 0.5])
    everything = np.arange(len(segments))
    for cell in stages.boxes(-0.9, 1.8 / 15, 16, stages.CELL):
        among = stages.kept(cell, segments, everything)
        points = pixels_of(cell, stages.CELL)
        np.testing.assert_allclose(nearest(points, segments[among]), nearest(points, segments), rtol=1e-12)
        close = ~stages.too_far(cell, stages.witness(cell, segments), segments)
        np.testing.assert_allclose(nearest(points, segments[close]), nearest(points, segments), rtol=1e-12)


def test_direction_tells_apart_more_than_distance():
    """Of a circle seen from well outside nearly everything is nearly as far."""
    turn = np.linspace(0, 2 * np.pi, 401)
    points = 0.2 * np.stack([np.cos(turn), np.sin(turn)], -1)
    segments = np.stack([points[:-1], points[1:]], 1)
    by_distance = by_direction = 0
    for cell in stages.boxes(-0.975, 0.05, 40, stages.CELL):
        by_distance += int((~stages.too_far(cell, stages.witness(cell, segments), segments)).sum())
        by_direction += len(stages.kept(cell, segments, np.arange(400)))
    assert by_direction < 0.5 * by_distance


def test_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(stages_figure, "PIXELS", 32)
    out = tmp_path / "new" / "stages.png"
    assert stages_figure.main(["--out", str(out)]) == 0
    assert out.stat().st_size > 20_000


def test_inside_of_a_square():
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    segments = np.stack([corners, np.roll(corners, -1, 0)], 1)
    points = np.array([[0.5, 0.5], [1.5, 0.5], [-0.5, 0.5], [0.5, 1.5], [0.25, 0.99]])
    assert stages.is_inside(points, segments).tolist() == [True, False, False, False, True]
