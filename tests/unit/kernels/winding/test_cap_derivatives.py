"""Factors of a field's polynomial are derivatives of the caps' solid angle, by multipoles and by edges."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest
import warp as wp

from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field, cubic_of, moved_field
from sdm.kernels.winding.cap_tree import Caps
from tests.unit.kernels.winding.test_cap_bounds import caps_of, exact_share, fan, torn

wp.set_module_options({"enable_backward": False})

# Exponents of x, y and z, in the order of the factors.
POWERS = [
    *([0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]),
    *([2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [1, 0, 1], [0, 1, 1]),
    *([3, 0, 0], [2, 1, 0], [2, 0, 1], [1, 2, 0], [1, 1, 1], [1, 0, 2], [0, 3, 0], [0, 2, 1], [0, 1, 2], [0, 0, 3]),
]


@wp.kernel
def _factors(
    caps: Caps, at: wp.array(dtype=wp.vec3), way: wp.vec3, radius: float, tolerance: float,
    stacks: wp.array(dtype=wp.int32), out: wp.array2d(dtype=float),
):  # fmt: skip
    i = wp.tid()
    stack = large_stack_of(stacks, 0)
    field = see_caps(caps, 0, at[i] - way, radius, tolerance, 256, Field(), -1, False, True, 0, stack, 0, 1, 1, False)
    field = moved_field(field, way)
    out[i, 0] = float(field.value)
    cubic = cubic_of(field.cubes)
    for axis in range(3):
        out[i, 1 + axis] = field.slope[axis]
        out[i, 4 + axis] = field.squares[axis]
        out[i, 7 + axis] = field.products[axis]
    for number in range(10):
        out[i, 10 + number] = cubic[number]


@cache
def expected(kind: str):
    """Caps, places, and the factors there by a fit of the sixth degree to exact values in a small ball."""
    rng = np.random.default_rng(2)
    structure, winding = caps_of(*(torn(rng) if kind == "torn" else fan(rng, kind)))
    caps = winding.caps
    at = rng.normal(size=(20, 3))
    at = (1.7 * at / np.linalg.norm(at, axis=1, keepdims=True)).astype(np.float32)
    size = 0.1
    off = rng.normal(size=(300, 3))
    off *= size * rng.random((300, 1)) ** (1 / 3) / np.linalg.norm(off, axis=1, keepdims=True)
    every = [p for p in itertools.product(range(7), repeat=3) if sum(p) <= 6]
    matrix = np.stack([np.prod((off / size) ** np.array(p), 1) for p in every], 1)
    share = exact_share(caps, (at[:, None] + off).reshape(-1, 3)).reshape(len(at), -1)
    found = np.linalg.lstsq(matrix, 4 * np.pi * share.T, rcond=None)[0].T
    return structure, caps, at, np.stack([found[:, every.index(tuple(p))] / size ** sum(p) for p in POWERS], 1)


@pytest.mark.parametrize("kind", ["ragged", "torn"])
@pytest.mark.parametrize("radius", [1e-4, 0.05])
@pytest.mark.parametrize("way", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.04)])
def test_factors_are_derivatives(kind, radius, way):
    _structure, caps, at, known = expected(kind)
    out = wp.zeros((len(at), len(POWERS)), dtype=float, device="cpu")
    stacks = wp.zeros(LARGE_STACK_ON_CPU, dtype=wp.int32, device="cpu")
    places = wp.array(at, dtype=wp.vec3, device="cpu")
    wp.launch(
        _factors,
        len(at),
        [caps, places, wp.vec3(*way), radius, 1e-6 + 30 * radius**4, stacks, out],
        device="cpu",
    )
    found = out.numpy()
    order = np.array(POWERS).sum(1)
    for degree, wrong in ((0, 0.005), (1, 0.005), (2, 0.05), (3, 0.2)):
        some = order == degree
        off = np.linalg.norm((found - known)[:, some], axis=1)
        assert off.max() < (wrong + 20 * any(way) * 0.05 ** (4 - degree)) * np.linalg.norm(known[:, some], axis=1).max()
