"""Steps on whole codes: derivatives against differences, their transposes, and the Gaussian's coordinates."""

from __future__ import annotations

import pytest
import torch

from sdm.deepsdf import DeepSDF, local, published
from sdm.deepsdf.infer.code_steps import CodeUnknowns, Evenness, prior_deviations
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.networks.code_gaussian import CodeGaussian
from sdm.deepsdf.samples import UnitSphere
from sdm.fit.model.pose import State, rotation_from_vector

SETTINGS = [
    local(width=16, global_size=8, grids=((4, 2),), code_deviation=0.5),
    local(width=16, global_size=8, grids=(), code_deviation=0.5),
    published(width=32, global_size=8, dropout=0.0, code_deviation=0.5),
]


def unknowns_of(settings) -> CodeUnknowns:
    torch.manual_seed(0)
    whole = AutoDecoder(settings, 5)
    with torch.no_grad():
        for weight in whole.decoder.last.parameters():
            weight.normal_(0, 0.1)
    spheres = [UnitSphere((1.0, 2.0, 3.0), 20.0 + k) for k in range(5)]
    model = DeepSDF(settings, whole.decoder, whole.bounded_codes(), [str(k) for k in range(5)], spheres)
    backend = DeepSDFBackend(model)
    theta = torch.tensor([21.0, 0.5, -1.0, 0.2, 1.5], dtype=torch.float64)
    turn = rotation_from_vector(torch.tensor([0.2, -0.1, 0.3], dtype=torch.float64))
    start = State(theta, turn, torch.tensor([4.0, 5.0, 6.0], dtype=torch.float64), backend.centre)
    return CodeUnknowns(backend, start, prior_deviations(backend))


@pytest.mark.parametrize("settings", SETTINGS, ids=["grids", "whole", "published"])
def test_products_are_those_of_differences(settings) -> None:
    unknowns = unknowns_of(settings)
    at = unknowns.start
    torch.testing.assert_close(
        unknowns.code(at), unknowns.backend.code(torch.tensor([21.0, 0.5, -1.0, 0.2, 1.5])), atol=1e-5, rtol=1e-4
    )
    random = torch.Generator().manual_seed(1)
    points = 15 * torch.randn(200, 3, generator=random, dtype=torch.float64)
    slopes = unknowns.slopes(at, points)
    torch.testing.assert_close(slopes.values, unknowns.distances(at, at.state.to_shape(points)), atol=1e-4, rtol=1e-4)
    for _ in range(4):
        step = torch.randn(len(at.standard) + 7, generator=random, dtype=torch.float64)
        ends = [unknowns.moved(at, s * 2e-3 * step) for s in (1, -1)]
        more, less = (unknowns.distances(end, end.state.to_shape(points)) for end in ends)
        change = (more - less) / 4e-3
        near = (unknowns.forward(slopes, at, step) - change).abs() < 0.02 + 0.05 * change.abs()
        # Where a ReLU bends between the two, a difference is neither slope.
        assert float(near.double().mean()) > 0.9
        pull = torch.randn(200, generator=random, dtype=torch.float64)
        one, other = unknowns.forward(slopes, at, step) @ pull, step @ unknowns.backward(slopes, at, pull)
        assert float(one) == pytest.approx(float(other), rel=1e-4, abs=1e-3)
        even = Evenness(unknowns, at, points, slopes.outward)
        one, other = even.forward(step) @ pull, step @ even.backward(pull)
        assert float(one) == pytest.approx(float(other), rel=1e-4, abs=1e-3)
        for product, (rows, similar) in (
            (unknowns.forward(slopes, at, step), (unknowns.rows(slopes, at), slopes.similar)),
            (even.forward(step), even.rows),
        ):
            dense = (rows @ unknowns.gaussian.spread(step[:-7].float())).double() + similar @ step[-7:]
            torch.testing.assert_close(product, dense, atol=1e-3, rtol=1e-3)
        moved = unknowns.moved(at, step)
        torch.testing.assert_close(unknowns.away(moved)[:-7] - unknowns.away(at)[:-7], step[:-7])
        torch.testing.assert_close(
            unknowns.away(unknowns.moved(at, 1e-3 * step))[-7:], 1e-3 * step[-7:], atol=1e-5, rtol=0.05
        )


def test_the_gaussian_is_standard_in_its_coordinates() -> None:
    codes = torch.randn(6, 20, generator=torch.Generator().manual_seed(0)) + 3.0
    gaussian = CodeGaussian(codes, 1.0)
    code = torch.randn(20, generator=torch.Generator().manual_seed(1))
    standard = gaussian.standard(code - gaussian.mean)
    torch.testing.assert_close(gaussian.spread(standard) + gaussian.mean, code, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(standard.square().sum(), gaussian.squared_distance(code[None])[0], rtol=1e-4, atol=1e-4)
