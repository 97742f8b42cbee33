"""A node's value is right up to its fourth moment: what is left falls with the sixth power of the distance."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from tests.unit.kernels.winding.test_cap_bounds import caps_of, exact_share, fan, torn

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _values(caps: Caps, at: wp.array(dtype=wp.vec3), stacks: wp.array(dtype=wp.int32), out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    stack = large_stack_of(stacks, 0)
    out[i] = see_caps(caps, 0, at[i], 0.0, 3.0, 0, Field(), -1, False, True, 0, stack, 0, 1, 1, False).value


@pytest.mark.parametrize("kind", ["round", "ragged", "torn"])
def test_what_a_root_leaves_out_falls_with_the_sixth_power(kind):
    rng = np.random.default_rng(7)
    structure, winding = caps_of(*(torn(rng) if kind == "torn" else fan(rng, kind)))
    caps = winding.caps
    # The root is node 1.
    x, y, z, radius = caps.moments.numpy()[MOMENTS_SIZE : MOMENTS_SIZE + 4]
    way = rng.normal(size=(200, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    wrong = []
    for far in (4, 8):
        at = (np.array([x, y, z]) + far * radius * way).astype(np.float32)
        out = wp.zeros(len(at), dtype=wp.float64, device="cpu")
        stacks = wp.zeros(LARGE_STACK_ON_CPU, dtype=wp.int32, device="cpu")
        wp.launch(_values, len(at), [caps, wp.array(at, dtype=wp.vec3, device="cpu"), stacks, out], device="cpu")
        wrong.append(np.linalg.norm(out.numpy() / (4 * np.pi) - exact_share(caps, at.astype(float))))
    assert 48 < wrong[0] / wrong[1] < 100
    assert structure.view is not None
