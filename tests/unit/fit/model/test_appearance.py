"""Appearance models: slopes against differences, and estimates of known mixtures."""

from __future__ import annotations

import pytest
import torch

from sdm.fit.model.appearance import MODELS, Appearance


def _data(count: int = 20_000) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(count, generator=generator, dtype=torch.float64)
    share = torch.where(torch.rand(count, generator=generator) < 0.7, share.round(), share)
    noise = torch.randn(count, generator=generator, dtype=torch.float64)
    return 100 + 900 * (1 - share) + 50 * noise, share


def _fitted(model: str, components: tuple[int, int] = (1, 1)) -> tuple[Appearance, torch.Tensor, torch.Tensor]:
    image, share = _data()
    appearance = MODELS[model].start(image, share, components)
    for _ in range(20):
        appearance = appearance.update(image, share)
    return appearance, image, share


def test_partial_volume_finds_means_and_noise() -> None:
    appearance, _, _ = _fitted("partial-volume")
    assert appearance.inside.mean == pytest.approx(100, abs=3)
    assert appearance.outside.mean == pytest.approx(1000, abs=3)
    assert appearance.inside.deviation == pytest.approx(50, abs=2)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("components", [(1, 1), (1, 2), (2, 2)])
def test_slopes_are_the_derivatives_by_share(model: str, components: tuple[int, int]) -> None:
    appearance, image, share = _fitted(model, components)
    image, share = image[:500], share[:500].clamp(0.05, 0.95)
    slope = appearance.evidence(image, share).slope
    for voxel in (0, 17, 333):
        step = torch.zeros_like(share)
        step[voxel] = 1e-5
        ahead = appearance.evidence(image, share + step).log_likelihood
        behind = appearance.evidence(image, share - step).log_likelihood
        assert (ahead - behind) / 2e-5 == pytest.approx(float(slope[voxel]), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_updates_never_lowers_the_likelihood(model: str) -> None:
    image, share = _data(5_000)
    appearance = MODELS[model].start(image, share, (1, 2))
    before = appearance.evidence(image, share).log_likelihood
    for _ in range(10):
        appearance = appearance.update(image, share)
        after = appearance.evidence(image, share).log_likelihood
        # The partial volume model's variances are moments, not exactly a maximum.
        assert after > before - (1e-6 if model == "labels" else 1e-3 * abs(before))
        before = after


def test_two_components_outside_are_told_apart() -> None:
    generator = torch.Generator().manual_seed(1)
    share = (torch.arange(9_000) < 3_000).double()
    means = torch.tensor([0.0, 500.0, 1_000.0]).double().repeat_interleave(3_000)
    image = means + 30 * torch.randn(9_000, generator=generator, dtype=torch.float64)
    appearance = MODELS["partial-volume"].start(image, share, (1, 2))
    for _ in range(30):
        appearance = appearance.update(image, share)
    assert sorted(appearance.outside.means.tolist()) == pytest.approx([500, 1000], abs=5)
    assert appearance.outside.weights.tolist() == pytest.approx([0.5, 0.5], abs=0.02)
