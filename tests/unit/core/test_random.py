from __future__ import annotations

import pytest
import torch

from sdm.core.random import torch_seed
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.train.settings import Settings


@pytest.mark.parametrize("seed", [0, 1, 2**63, 2**64 - 1, -1, -(2**63)])
def test_seeds_that_torch_takes_stay_as_they_are(seed):
    assert torch_seed(seed) == seed
    torch.Generator().manual_seed(torch_seed(seed))


@pytest.mark.parametrize("seed", [2**64, 99999999999999999999999, -(2**63) - 1])
def test_longer_ones_are_cut(seed):
    torch.Generator().manual_seed(torch_seed(seed))


def test_a_model_of_a_long_seed():
    codes = [AutoDecoder(Settings(seed=10**23 + i), 2).codes for i in (0, 0, 1)]
    assert torch.equal(codes[0], codes[1])
    assert not torch.equal(codes[0], codes[2])
