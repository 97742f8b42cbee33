"""Values of the wrong type in Python: each is refused in a sentence, where the call is made."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.errors import SDMError

FAMILY = sdm.shapes.Ellipsoid.example()
GRID = sdm.Grid((0, 0, 0), (1, 1, 1), (2, 2, 2))
TRIANGLE = sdm.TriangleMesh(torch.eye(3), torch.tensor([[0, 1, 2]], dtype=torch.int32))

CASES = [
    (lambda: sdm.SDMStream("cochlea", GRID), "'cochlea' is no family of shapes: sdm.shapes.load_family"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.SDMStream(FAMILY, GRID, seed="a"), "the seed is 'a'; give a whole number"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.SDMStream(FAMILY, GRID, batch_size=2.5), "batch size is 2.5; give a whole number"),  # pyright: ignore[reportArgumentType]
    (lambda: FAMILY.mesh("a"), "the values of theta hold"),
    (lambda: FAMILY.mesh(None), "the values of theta hold"),
    (lambda: FAMILY.sample(-1), "-1 samples from number 0 were requested"),
    (lambda: sdm.shapes.Cochlea(triangles=600).vertices([[3.6, 0.3, 0.139, 0.0]]), "theta is list"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.SDM("map", GRID), "values of a map are real numbers, not <U3"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.SDM([[[0.0]]], GRID), r"values of shape \(1, 1, 1\) do not fit"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.Grid.around(TRIANGLE, "8"), "resolution '8' must be a whole number"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.signed_distance_map(TRIANGLE, np.zeros((4, 4, 4))), r"resolution of shape \(4, 4, 4\) must be"),
    (lambda: sdm.signed_distance_maps(TRIANGLE, 8), r"give them in a list, \[mesh\]"),
    (lambda: sdm.watertight(TRIANGLE, "8"), "resolution '8' is too low"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.watertight(TRIANGLE, float("nan")), "resolution nan is too low"),  # pyright: ignore[reportArgumentType]
]


@pytest.mark.parametrize(("call", "said"), CASES, ids=[said for _, said in CASES])
def test_a_wrong_type_is_one_sentence(call, said):
    with pytest.raises(SDMError, match=said) as found:
        call()
    assert "\n" not in str(found.value)
