"""Wherever in the box theta is, shapes are sound, and samples do not care how they are requested."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sdm.shapes import Cochlea, GeometricShapes, sobol, uniform

COCHLEA = Cochlea(3_000)
SOLIDS = GeometricShapes(triangles=300)
# Towards the ends of the box more often than a uniform number would be.
SHARE = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1, width=32))


def enclosed_volume(vertices: torch.Tensor, faces: torch.Tensor) -> float:
    a, b, c = vertices.double()[faces.long()].unbind(1)
    return float((a * b.cross(c, dim=1)).sum() / 6)


@settings(max_examples=24)
@given(st.lists(SHARE, min_size=4, max_size=4))
@example([0, 1, 1, 0])
@example([1, 1, 0, 0])
def test_cochleae_do_not_meet_themselves(share):
    cgal = pytest.importorskip("igl.copyleft.cgal", reason="libigl, which finds self-intersections, is not installed")
    vertices = COCHLEA.vertices(COCHLEA.from_unit(torch.tensor([share])))[0]
    assert enclosed_volume(vertices, COCHLEA.faces) > 1
    found = cgal.remesh_self_intersections(
        vertices.double().numpy(), COCHLEA.faces.numpy().astype(np.int64), detect_only=True
    )
    assert np.asarray(found[2]).size == 0
    # The tube never reaches the axis.
    assert float(vertices[:, :2].norm(dim=1).min()) > 0.01


@settings(max_examples=24)
@given(st.lists(SHARE, min_size=10, max_size=10))
def test_solids_have_an_inside(share):
    theta = SOLIDS.from_unit(torch.tensor([share]))
    vertices = SOLIDS.vertices(theta)[0]
    assert bool(torch.isfinite(vertices).all())
    assert enclosed_volume(vertices, SOLIDS.faces) > 0.2**3


@settings(max_examples=30)
@given(
    st.integers(0, 2**64 - 1),
    st.lists(st.integers(0, 2**40), min_size=1, max_size=20),
    st.integers(1, 30),
    st.sampled_from([uniform, sobol]),
)
def test_a_sample_depends_on_seed_and_number_alone(seed, numbers, width, draw):
    together = draw(seed, numbers, width)
    for row, number in zip(together, numbers, strict=True):
        assert torch.equal(row, draw(seed, [number], width)[0])
    assert bool(((together >= 0) & (together < 1)).all())
