"""The checks of jaxtyping's annotations are at work in these tests."""

from __future__ import annotations

import jaxtyping
import pytest
import torch
from beartype.roar import BeartypeDoorHintViolation

import sdm
from sdm.core import mesh


def test_another_shape_is_noticed():
    with pytest.raises(jaxtyping.TypeCheckError, match="V 3"):
        mesh._check_values(torch.zeros(3, 4), torch.zeros(1, 3, dtype=torch.int32), "a mesh")


def test_another_type_is_noticed():
    grid = sdm.Grid((0, 0, 0), (1, 1, 1), (2, 3, 4))
    with pytest.raises(BeartypeDoorHintViolation, match="nx ny nz"):
        sdm.SDM(torch.zeros(2, 3, 4, dtype=torch.int32), grid)


def test_what_is_given_may_be_wider_than_what_is_kept():
    kept = sdm.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert kept.vertices.dtype == torch.float32
