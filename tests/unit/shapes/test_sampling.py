"""Samples are pure functions of seed and number."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from scipy import stats

from sdm.errors import MeshError
from sdm.kernels.shapes import counter_random
from sdm.shapes import Cochlea, grid, sobol, uniform


def philox_reference(counter: list[int], key: list[int]) -> list[int]:
    c, k, mask = list(counter), list(key), 0xFFFFFFFF
    for _ in range(10):
        first, second = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(second >> 32) ^ c[1] ^ k[0], second & mask, (first >> 32) ^ c[3] ^ k[1], first & mask]
        k = [(k[0] + 0x9E3779B9) & mask, (k[1] + 0xBB67AE85) & mask]
    return c


def test_reference_has_the_published_answers():
    # Known answers of the Random123 library.
    assert philox_reference([0] * 4, [0] * 2) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    pi = [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344], [0xA4093822, 0x299F31D0]
    assert philox_reference(*pi) == [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1]


def test_kernel_is_philox():
    seed, numbers = 0x299F31D0A4093822, [0, 5, 2**32 + 7, 2**62]
    values = wp.zeros((4, 6), dtype=wp.uint32, device="cpu")
    counter_random.fill_words(seed, 3, wp.array(numbers, dtype=wp.int64, device="cpu"), values, "cpu")
    for row, number in zip(values.numpy(), numbers, strict=True):
        words = []
        for block in range(2):
            words += philox_reference([number & 0xFFFFFFFF, number >> 32, block, 3], [seed & 0xFFFFFFFF, seed >> 32])
        assert row.tolist() == words[:6]


@pytest.mark.parametrize("draw", [uniform, sobol])
def test_any_split_gives_the_same(draw):
    whole = draw(7, range(1000), 5)
    parts = torch.cat([draw(7, range(a, b), 5) for a, b in [(0, 1), (1, 33), (33, 1000)]])
    assert torch.equal(whole, parts)
    order = torch.randperm(1000, generator=torch.Generator().manual_seed(0))
    assert torch.equal(draw(7, order, 5), whole[order])
    assert not torch.equal(draw(8, range(1000), 5), whole)


@pytest.mark.parametrize("draw", [uniform, sobol])
def test_in_the_unit_cube_and_uniform(draw):
    values = draw(3, range(1 << 14), 7)
    assert values.dtype == torch.float32
    assert float(values.min()) >= 0
    assert float(values.max()) < 1
    for column in values.T.double().numpy():
        assert stats.kstest(column, "uniform").statistic < 0.012
    assert np.abs(np.corrcoef(values.T.numpy()) - np.eye(7)).max() < 0.035


def test_prefix_of_the_axes_is_the_same():
    assert torch.equal(uniform(1, range(50), 9)[:, :4], uniform(1, range(50), 4))
    assert torch.equal(sobol(1, range(50), 9)[:, :4], sobol(1, range(50), 4))


def test_sobol_is_torchs_sequence_under_a_shift():
    ours = (sobol(5, range(4096), 6).double() * 2**24).long()
    theirs = (torch.quasirandom.SobolEngine(6).draw(4096, dtype=torch.float64) * 2**24).long()
    shift = ours ^ theirs
    assert torch.equal(shift, shift[:1].expand_as(shift))


def test_sobol_is_more_even_than_chance():
    discrepancy = stats.qmc.discrepancy
    assert discrepancy(sobol(0, range(512), 4).double().numpy()) < 0.2 * discrepancy(
        uniform(0, range(512), 4).double().numpy()
    )


def test_sobol_goes_on_after_its_last_point():
    first, again = sobol(0, [5], 3), sobol(0, [2**30 + 5], 3)
    assert not torch.equal(first, again)


def test_grid():
    points = grid(5, 4)
    assert points.shape == (625, 4)
    assert len(torch.unique(points, dim=0)) == 625
    assert set(points.reshape(-1).tolist()) == {0.0, 0.25, 0.5, 0.75, 1.0}
    with pytest.raises(MeshError, match="2 or more"):
        grid(1, 4)
    with pytest.raises(MeshError, match="too large"):
        grid(100, 10)


def test_family_samples():
    family = Cochlea(500)
    theta = family.sample(100, seed=2, device="cpu")
    assert torch.equal(family.check(theta), theta)
    assert torch.equal(family.sample(10, seed=2, start=90, device="cpu"), theta[90:])
    assert torch.equal(family.sample_at([3, 99], seed=2), theta[[3, 99]])
    assert family.grid_samples(5, device="cpu").shape == (625, 4)
    torch.testing.assert_close(family.from_unit(family.to_unit(theta)), theta)
    with pytest.raises(MeshError, match="no sampler called 'halton'; use uniform, sobol, chebyshev"):
        family.sample(1, sampler="halton")
    with pytest.raises(MeshError, match="sample numbers"):
        family.sample_at(torch.tensor([[1, 2]]))


def test_negative_and_large_seeds():
    assert torch.equal(uniform(-1, [4], 2), uniform(2**64 - 1, [4], 2))
    assert not torch.equal(uniform(2**32, [4], 2), uniform(0, [4], 2))
