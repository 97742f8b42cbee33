"""Near twins are found whatever their pose, others are not; groups stay on one side of a split."""

from __future__ import annotations

from itertools import chain

import pytest
import torch
import trimesh

from sdm import TriangleMesh
from sdm.sampling.near_twins import Surface, distance_between, distances_between, laid_on, near_twins, split_groups


def box(sides: tuple[float, float, float], turned: float = 0.0, shift: float = 0.0) -> TriangleMesh:
    made = trimesh.creation.box(sides).subdivide().subdivide()
    made.apply_transform(trimesh.transformations.rotation_matrix(turned, [1.0, 2.0, 3.0]))
    made.apply_translation([shift, -2 * shift, shift])
    return TriangleMesh(made.vertices, made.faces)


def test_one_shape_in_two_poses_is_at_no_distance() -> None:
    assert distance_between(Surface(box((3, 5, 8))), Surface(box((3, 5, 8), 0.15, 40.0))) < 0.02


def test_concentric_balls_are_apart_by_the_difference_of_their_radii() -> None:
    small, large = (trimesh.creation.icosphere(4, r) for r in (9.0, 10.0))
    large.apply_translation([100.0, 0.0, 0.0])
    a, b = (Surface(TriangleMesh(m.vertices, m.faces)) for m in (small, large))
    assert distance_between(a, b) == pytest.approx(1.0, rel=0.02)


def test_a_part_that_was_seen_lays_a_shape_where_the_part_is() -> None:
    whole, moved = Surface(box((3, 5, 8))), box((3, 5, 8), 0.1, 0.3)
    points = Surface(moved).many
    half = points[points[:, 2] > points[:, 2].median()]
    turn, shift = laid_on(whole, Surface(moved), seen=half, steps=60)
    back = (half - shift) @ turn
    assert float((back - whole.nearest(back)).norm(dim=1).mean()) < 0.05
    assert torch.allclose(turn @ turn.T, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(turn)) == pytest.approx(1.0)


def test_twins_of_twins_are_one_group() -> None:
    found = distances_between(
        [box((3, 5, 8)), box((6, 6, 6)), box((3.02, 5, 8), 0.1, 9.0), box((6, 6, 6.02), 0.0, 3.0)]
    )
    assert torch.equal(found, found.T)
    assert float(found.diagonal().abs().max()) == 0
    assert near_twins(found, 0.1) == [[0, 2], [1, 3]]
    assert near_twins(found, 1e-9) == [[0], [1], [2], [3]]
    chain = torch.full((4, 4), 9.0)
    chain[0, 3] = chain[3, 0] = chain[3, 1] = chain[1, 3] = 0.5
    assert near_twins(chain, 1.0) == [[0, 1, 3], [2]]


def test_a_split_keeps_groups_together() -> None:
    groups = [["a", "b", "c"], ["d", "e"], *([f"{n}"] for n in range(20))]
    for seed in range(20):
        parts = split_groups(groups, {"test": 6, "validation": 4}, "training", seed=seed)
        assert sorted(chain.from_iterable(parts.values())) == sorted(chain.from_iterable(groups))
        assert 6 <= len(parts["test"]) <= 8
        assert 4 <= len(parts["validation"]) <= 6
        for group in groups:
            assert sum(bool(set(group) & set(part)) for part in parts.values()) == 1
    firsts = {split_groups(groups, {"test": 1}, "training", seed=seed)["test"][0] for seed in range(20)}
    assert len(firsts) > 5
    assert split_groups(groups, {"test": 6}, "x", seed=3) == split_groups(groups, {"test": 6}, "x", seed=3)
