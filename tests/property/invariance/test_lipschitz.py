"""A signed distance to a closed mesh never changes by more than the way that was gone."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import sdm
from tests.helpers import strategies
from tests.helpers.exactness import ROUNDING, scale_of

closed = st.one_of(strategies.closed(), strategies.shells())


@settings(max_examples=40)
@given(strategies.anywhere(closed), strategies.seeds)
def test_signed_between_points(mesh, seed):
    points = strategies.points_about(mesh, seed)
    rng = np.random.default_rng(seed)
    other = points[rng.permutation(len(points))]
    near = points + (points - other) * 10.0 ** rng.uniform(-7, -1, (len(points), 1)).astype(np.float32)
    _check(mesh, points, other)
    _check(mesh, points, near.astype(np.float32))


def _check(mesh: strategies.Arrays, points: np.ndarray, other: np.ndarray) -> None:
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    change = (index.signed_distance(points).double() - index.signed_distance(other).double()).abs().numpy()
    way = np.linalg.norm(points.astype(np.float64) - other, axis=1)
    slack = (
        8
        * ROUNDING
        * np.maximum(scale_of(mesh.vertices, mesh.faces, points), scale_of(mesh.vertices, mesh.faces, other))
    )
    assert (change <= way + slack).all()


@settings(max_examples=30)
@given(st.one_of(closed, strategies.slivers()), st.sampled_from([0.11, 0.5, 1.0]))
def test_between_neighbouring_voxels(mesh, spacing):
    grid = sdm.Grid([-4] * 3, [spacing, 0.8 * spacing, 1.1 * spacing], [13, 12, 11])
    field = sdm.signed_distance_map(sdm.TriangleMesh(*mesh), grid, device="cpu")
    values = field.values.double()
    # The sign of an open mesh may change off its surface, where the winding number is a half.
    if not sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu").closed:
        values = values.abs()
    slack = 8 * ROUNDING * scale_of(mesh.vertices, mesh.faces, grid.points().reshape(-1, 3).numpy()).max()
    for axis, step in enumerate(grid.spacing):
        assert values.diff(dim=axis).abs().max() <= step + slack
