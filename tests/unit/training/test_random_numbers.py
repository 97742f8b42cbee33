from __future__ import annotations

import pytest
import torch

from sdm.training.random_numbers import own_random_numbers


def test_nobody_elses_random_numbers_change():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    with pytest.raises(KeyError), own_random_numbers("cpu"):
        torch.manual_seed(1)
        torch.rand(7)
        raise KeyError
    assert torch.equal(torch.rand(3), expected)
