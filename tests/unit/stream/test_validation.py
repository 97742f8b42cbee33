"""The fixed validation set: the same every time, named by what is in it, never part of the stream."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.stream import SDMStream

FAMILY = Cochlea(600)


def stream(**options):
    return SDMStream(FAMILY, FAMILY.grid(10), 4, **{"device": "cpu", "seed": 3, **options})


def test_is_the_same_every_time_and_has_its_name():
    first, second = stream().validation(5), stream(sampler="sobol").validation(5)
    assert first.name == second.name
    assert torch.equal(first.sdm, second.sdm)
    assert first.name.startswith("val-")
    assert len(first.name) == 20


@pytest.mark.parametrize("options", [{"seed": 4}, {"dtype": torch.bfloat16}, {"truncate": 1.0}])
def test_other_content_has_another_name(options):
    names = {stream().validation(5).name, stream().validation(4).name, stream(**options).validation(5).name}
    assert len(names) == 3


def test_is_not_in_the_stream_and_leaves_it_alone():
    source = stream()
    held = source.validation(8)
    assert source.position == 0
    seen = torch.cat([source.sample(list(range(64))).theta, held.theta])
    assert len(set(map(tuple, seen.tolist()))) == 72


def test_reads_like_a_data_set():
    held = stream().validation(5)
    assert len(held) == 5
    assert [len(b.theta) for b in held.batches(2)] == [2, 2, 1]
    assert torch.equal(torch.cat([b.sdm for b in held.batches(2)]), held.sdm)
    assert held[3].sdm.shape == (1, 10, 10, 10)
    with pytest.raises(SDMError, match="at least 1"):
        stream().validation(0)
