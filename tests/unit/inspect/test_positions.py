"""Vertices at equal positions, found by keys that may meet and never decide."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.inspect import positions
from sdm.inspect.positions import are_distinct, first_at_position


def by_looking(vertices: np.ndarray) -> list[int]:
    known: dict[tuple[float, ...], int] = {}
    return [known.setdefault(tuple(row.tolist()), number) for number, row in enumerate(vertices)]


@pytest.mark.parametrize("keys", ["mixed", "one for all", "of x alone"])
def test_whatever_the_keys_are(keys, monkeypatch):
    if keys == "one for all":
        monkeypatch.setattr(positions, "_keys", lambda vertices: np.zeros(len(vertices), np.uint64))
    elif keys == "of x alone":
        monkeypatch.setattr(positions, "_keys", lambda vertices: np.round(vertices[:, 0] * 10 + 50).astype(np.uint64))
    rng = np.random.default_rng(0)
    vertices = rng.integers(-2, 3, (400, 3)).astype(np.float32) * np.float32(0.1)
    # Zeros of both signs are one place.
    vertices[::7] *= -1
    assert first_at_position(vertices).tolist() == by_looking(vertices)
    assert not are_distinct(vertices)
    assert first_at_position(vertices[:1]).tolist() == [0]


def test_distinct_ones():
    vertices = np.random.default_rng(1).random((5000, 3)).astype(np.float32)
    assert are_distinct(vertices)
    assert first_at_position(vertices).tolist() == list(range(5000))
    vertices[4000] = vertices[7]
    assert not are_distinct(vertices)
    # Coordinates in another order are another place.
    assert are_distinct(np.concatenate([vertices[:100], vertices[:100, ::-1]]))
    assert are_distinct(np.zeros((0, 3), np.float32))


@pytest.mark.parametrize("step", [1.0, 0.25, 0.1, 1e-3])
def test_keys_of_a_grid_do_not_meet(step):
    index = np.stack(np.meshgrid(*[np.arange(-12, 12)] * 3, indexing="ij"), -1).reshape(-1, 3)
    assert are_distinct(index.astype(np.float32) * np.float32(step))
    assert not are_distinct(np.array([[0, 1, 2], [-0.0, 1, 2]], np.float32))
