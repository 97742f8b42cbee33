"""The place from which one voxel of a line is nearer than another, in float32, as on a GPU, and in float64."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sdm.kernels.edt.envelopes import first_won_by_costs, solved


@wp.kernel(enable_backward=False)
def both_ways(
    sites: wp.array2d(dtype=wp.int32),
    heights: wp.array2d(dtype=wp.float32),
    half: float,
    found: wp.array2d(dtype=wp.int32),
):
    i = wp.tid()
    low, high = sites[i, 0], sites[i, 1]
    below, above = heights[i, 0], heights[i, 1]
    found[i, 0] = first_won_by_costs(low, below, high, above, 1.0, half)
    found[i, 1] = solved(low, high, wp.float64(above) - wp.float64(below), wp.float64(1.0), wp.float64(half))


@pytest.mark.parametrize("half", [0.0, 0.5])
def test_whole_heights_in_float32(half):
    """On grids whose voxels are cubes squared distances are exact, and so is the place, by a search."""
    random = np.random.default_rng(0)
    sites = np.sort(random.integers(0, 300, (20_000, 2)), 1).astype(np.int32)
    sites = sites[sites[:, 0] < sites[:, 1]]
    away = random.integers(1, 300, (len(sites), 2, 2))
    heights = ((away - half) ** 2 * random.integers(0, 2, away.shape)).sum(-1).astype(np.float32)
    found = wp.zeros(sites.shape, dtype=wp.int32, device="cpu")
    inputs = [wp.array(sites, dtype=wp.int32, device="cpu"), wp.array(heights, dtype=wp.float32, device="cpu"), half]
    wp.launch(both_ways, len(sites), inputs=[*inputs, found], device="cpu")
    x = np.arange(-1, 301)
    costs = heights[:, :, None] + np.maximum(abs(x - sites[:, :, None]) - half, 0.0) ** 2
    wins = costs[:, 1] <= costs[:, 0]
    sure = wins.any(1) & ~wins[:, 0]
    first = x[wins.argmax(1)][sure]
    assert sure.sum() > 5_000
    np.testing.assert_array_equal(found.numpy()[sure], np.stack([first, first], 1))
