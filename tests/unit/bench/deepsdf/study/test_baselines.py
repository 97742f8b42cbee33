"""Trivial answers: the copy is the nearest shape, laid on it if that is wanted; a coarse map of a ball is a ball."""

from __future__ import annotations

import pytest
import trimesh

from sdm import TriangleMesh
from sdm.bench.deepsdf.study.baselines import coarse_map, nearest_copy
from sdm.deepsdf import score_shape
from sdm.sampling.near_twins import Surface


def ellipsoid(*axes: float, shift: float = 0.0, name: str = "mesh") -> Surface:
    made = trimesh.creation.icosphere(3)
    made.apply_scale(axes)
    made.apply_translation([shift, 0.0, 0.0])
    return Surface(TriangleMesh(made.vertices, made.faces, name))


def test_the_nearest_is_copied_as_it_is_or_laid_on() -> None:
    shape = ellipsoid(0.9, 0.6, 0.4)
    training = [ellipsoid(0.5, 0.5, 0.5), ellipsoid(0.9, 0.6, 0.4, shift=0.12), ellipsoid(0.88, 0.6, 0.45)]
    assert nearest_copy(shape, training).number == 2
    laid = nearest_copy(shape, training, laid=True)
    assert laid.number == 1
    assert laid.distance < 0.01
    assert score_shape(laid.mesh, shape.index.mesh, points=1000, resolution=24).mean < 0.01


def test_a_copy_for_half_of_a_shape_is_chosen_by_that_half() -> None:
    shape = ellipsoid(0.9, 0.6, 0.4)
    half = shape.many[shape.many[:, 0] > 0.3]
    # Alike where it was seen, unlike elsewhere; and the other way round.
    training = [ellipsoid(0.9, 0.6, 0.4, shift=0.02), ellipsoid(0.7, 0.6, 0.4, shift=-0.2)]
    assert nearest_copy(shape, training, seen=half).number == 0
    assert nearest_copy(shape, training, seen=half).distance == pytest.approx(0.01, abs=0.01)


def test_coarse_maps() -> None:
    ball = ellipsoid(0.8, 0.8, 0.8).index.mesh
    found = score_shape(coarse_map(ball, 12, 48), ball, points=2000, resolution=32)
    assert found.dice > 0.98
    assert found.mean < 0.01
    assert score_shape(coarse_map(ball, 5, 48), ball, points=2000, resolution=32).mean > found.mean
