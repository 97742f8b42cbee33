"""However many processes, workers and restarts: every sample once, and always the same."""

from __future__ import annotations

import itertools
from functools import cache

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sdm.core.grid import Grid
from sdm.shapes import Cuboid
from sdm.stream import SDMStream

FAMILY = Cuboid(triangles=12)
SAMPLERS = ("uniform", "sobol", "grid:2", "grid:2:ordered")


@cache
def grid() -> Grid:
    return FAMILY.grid(3)


def stream(batch_size, rank, world, sampler="uniform"):
    return SDMStream(FAMILY, grid(), batch_size, 9, rank, world, device="cpu", sampler=sampler)


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3)), min_size=1, max_size=3),
    st.sampled_from(SAMPLERS[:2]),
)
def test_every_sample_once_whatever_the_restarts(runs, sampler):
    """Each run has a batch size, a number of ranks and a number of steps, and goes on from the last one's state."""
    seen: dict[int, torch.Tensor] = {}
    state = None
    for batch_size, world, steps in runs:
        states = []
        for rank in range(world):
            source = stream(batch_size, rank, world, sampler)
            if state is not None:
                source.load_state_dict(state)
            for batch in itertools.islice(source, steps):
                for number, values in zip(batch.index.tolist(), batch.sdm, strict=True):
                    assert number not in seen
                    seen[number] = values
            states.append(source.state_dict())
        assert all(s == states[0] for s in states)
        state = states[0]
    assert sorted(seen) == list(range(len(seen)))
    whole = stream(1, 0, 1, sampler).sample(sorted(seen)).sdm
    assert torch.equal(torch.stack([seen[n] for n in sorted(seen)]), whole)


@settings(max_examples=30)
@given(st.lists(st.integers(0, 1 << 40), min_size=1, max_size=20), st.sampled_from(SAMPLERS))
def test_a_sample_does_not_know_its_neighbours(numbers, sampler):
    source = stream(1, 0, 1, sampler)
    together = source.sample(numbers)
    for place in (0, len(numbers) // 2, len(numbers) - 1):
        alone = source.sample(numbers[place])
        assert torch.equal(alone.theta[0], together.theta[place])
        assert torch.equal(alone.sdm[0], together.sdm[place])
