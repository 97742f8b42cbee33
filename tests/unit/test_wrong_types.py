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


class Own(sdm.shapes.Family):
    """A family of a user's, whose faces and vertices are to be wrong."""

    name = "own"
    parameters = (sdm.shapes.Parameter("r", 1.0, 2.0),)

    def __init__(self, triangles: object = TRIANGLE.faces, samples: slice = slice(None), dtype=torch.float32) -> None:
        self.triangles, self.samples, self.dtype = triangles, samples, dtype  # pyright: ignore[reportAttributeAccessIssue]

    def vertices(self, theta: torch.Tensor) -> torch.Tensor:
        return (torch.eye(3).to(theta) * theta[self.samples, :, None]).to(self.dtype)


CASES = [
    (lambda: sdm.SDMStream(Own(TRIANGLE.faces.long()), GRID), r"Own has triangles \(1, 3\) torch.int64"),
    (lambda: sdm.SDMStream(Own(TRIANGLE.faces.numpy()), GRID), "Own needs `parameters` and `triangles`"),
    (lambda: sdm.SDMStream(Own(samples=slice(1)), GRID), r"Own gives vertices \(1, 3, 3\) for theta \(2, 1\)"),
    (lambda: sdm.SDMStream(Own(dtype=torch.float64), GRID), "Own gives vertices of torch.float64"),
    (lambda: sdm.metrics.dice("a", "b"), "the prediction holds <U1 values"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.sampling.sample(TRIANGLE, 2.5), "2.5 samples from number 0"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.sampling.SampleLaw(near=1.5), "near, uniform, surface = 1.5, 5, 0 is no law"),  # pyright: ignore[reportArgumentType]
    (lambda: sdm.sampling.surface_points(TRIANGLE, -1), "-1 points were requested"),
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


def test_masks_of_numpy_are_those_of_torch():
    truth = np.zeros((6, 7, 8), np.uint8)
    truth[1:4, 2:5, 2:6] = 2
    prediction = np.roll(truth, 1, axis=0)[:, ::-1]
    own = sdm.metrics.evaluate_segmentation(prediction, truth, 1.5)
    assert own == sdm.metrics.evaluate_segmentation(torch.tensor(prediction.copy()), torch.tensor(truth), 1.5)
    assert 0 < own.dice < 1
