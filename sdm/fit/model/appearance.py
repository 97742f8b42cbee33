"""Appearance: intensities inside and outside as mixtures of Gaussians, estimated by expectation-maximisation.

Two models of a voxel that holds a share p of inside:

- `PartialVolume`: its intensity is p u + (1 - p) v plus noise, with one component u of the inside and one component v
  of the outside (partial volume mixtures, Van Leemput et al. 2003). The default: what scanners do.
- `Labels`: it is inside with probability p and outside else, and its intensity is of that class alone (Wang et al.,
  Medical Image Analysis 2022).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

# Least standard deviation of a component, as a share of the image's.
LEAST_SPREAD = 1e-3


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of K Gaussians: weights, means and variances, (K,) float64 each."""

    weights: Tensor
    means: Tensor
    variances: Tensor

    @property
    def mean(self) -> float:
        """Mean intensity."""
        return float((self.weights * self.means).sum())

    @property
    def deviation(self) -> float:
        """Standard deviation of the whole mixture."""
        second = (self.weights * (self.variances + self.means**2)).sum()
        return math.sqrt(max(0.0, float(second) - self.mean**2))


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log-likelihood of an image, with its derivatives.

    Args:
        log_likelihood: Of the whole image.
        slope: (N,) its derivative by each voxel's share of inside.
        rows: (N,1+K) square roots of the information: by the share of inside, then by each mean intensity. Their
            products summed over voxels, `rows.T @ rows`, are a positive approximation of minus the second derivative.
    """

    log_likelihood: float
    slope: Tensor
    rows: Tensor


@dataclass(frozen=True, eq=False)
class Appearance:
    """Appearance inside and outside; `least` is the smallest variance that a component may have."""

    inside: Mixture
    outside: Mixture
    least: float

    @classmethod
    def start(cls, image: Tensor, share: Tensor, components: tuple[int, int] = (1, 1)) -> Appearance:
        """From a first guess at the share of inside (N,) of an image's voxels (N,)."""
        least = (LEAST_SPREAD**2) * float(image.var()) + 1e-30
        parts = [_spread(image, w, k, least) for w, k in zip((share, 1 - share), components, strict=True)]
        return cls(parts[0], parts[1], least)

    def update(self, image: Tensor, share: Tensor) -> Appearance:
        """One step of expectation-maximisation at a fixed share of inside."""
        raise NotImplementedError

    def with_means(self, image: Tensor, share: Tensor) -> Appearance:
        """The same step for the means alone: weights and variances are held."""
        means = self.means(image, share)
        inside, outside = means.split([self.inside.means.numel(), self.outside.means.numel()])
        return replace(self, inside=replace(self.inside, means=inside), outside=replace(self.outside, means=outside))

    def means(self, image: Tensor, share: Tensor) -> Tensor:
        """Means (I+J,) of the components inside, then outside, after one step."""
        raise NotImplementedError

    def evidence(self, image: Tensor, share: Tensor) -> Evidence:
        """Log-likelihood of the image at a share of inside (N,), with its derivatives."""
        raise NotImplementedError


class PartialVolume(Appearance):
    """Intensities mix as the shares do."""

    def update(self, image: Tensor, share: Tensor) -> PartialVolume:
        """One step: components' shares, their means by weighted least squares, then their variances."""
        _, variance, belong, _ = self._pairs(image, share)
        count = self.inside.means.numel()
        design = self._design(share)
        means = self._solve_means(image, belong / variance, design)
        square = (image[:, None, None] - torch.einsum("nijk,k->nij", design, means)) ** 2
        parts = []
        for axis, mixture, part, chosen in (
            (2, self.inside, share, means[:count]),
            (1, self.outside, 1 - share, means[count:]),
        ):
            own = belong * part[:, None, None]
            mass = own.sum(axis).sum(0)
            spread = (own * square).sum(axis).sum(0) / mass.clamp_min(1e-12)
            spread = torch.where(mass > 1e-6, spread, mixture.variances).clamp_min(self.least)
            parts.append(Mixture((mass + 1e-9) / (mass + 1e-9).sum(), chosen, spread))
        return replace(self, inside=parts[0], outside=parts[1])

    def means(self, image: Tensor, share: Tensor) -> Tensor:
        """See `Appearance.means`: by weighted least squares."""
        _, variance, belong, _ = self._pairs(image, share)
        return self._solve_means(image, belong / variance, self._design(share))

    def evidence(self, image: Tensor, share: Tensor) -> Evidence:
        """See `Appearance.evidence`."""
        mean, variance, belong, log_likelihood = self._pairs(image, share)
        contrast = self.inside.means[:, None] - self.outside.means
        widening = self.inside.variances[:, None] - self.outside.variances
        miss = (image[:, None, None] - mean) / variance
        slope = miss * contrast + 0.5 * widening * (miss**2 - 1 / variance)
        root = variance.rsqrt()
        by_share = (belong * contrast * root).sum((1, 2))
        by_mean = torch.einsum("nij,nijk->nk", belong * root, self._design(share))
        rows = torch.cat([by_share[:, None], by_mean], 1)
        return Evidence(float(log_likelihood.sum()), (belong * slope).sum((1, 2)), rows)

    def _solve_means(self, image: Tensor, weight: Tensor, design: Tensor) -> Tensor:
        """Least squares over pairs of components, by their weights (N,I,J) and means' derivatives (N,I,J,I+J)."""
        normal = torch.einsum("nij,nijk,nijl->kl", weight, design, design)
        right = torch.einsum("nij,nijk,n->k", weight, design, image)
        # A component without voxels keeps its mean.
        ridge = 1e-9 * normal.diagonal().max().clamp_min(1e-30)
        old = torch.cat([self.inside.means, self.outside.means])
        identity = torch.eye(len(old), dtype=torch.float64, device=old.device)
        return torch.linalg.solve(normal + ridge * identity, right + ridge * old)

    def _design(self, share: Tensor) -> Tensor:
        """Derivatives (N,I,J,I+J) of each pair's mean (N,I,J) by the means of the I + J components."""
        count, other = self.inside.means.numel(), self.outside.means.numel()
        first = torch.eye(count, device=share.device).double()[:, None].expand(count, other, count)
        second = torch.eye(other, device=share.device).double()[None].expand(count, other, other)
        p = share[:, None, None, None]
        return torch.cat([p * first, (1 - p) * second], -1)

    def _pairs(self, image: Tensor, share: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Mean, variance and responsibility (N,I,J) of each pair of components; log-likelihood (N,)."""
        p = share[:, None, None]
        mean = p * self.inside.means[:, None] + (1 - p) * self.outside.means
        variance = p * self.inside.variances[:, None] + (1 - p) * self.outside.variances
        prior = (self.inside.weights[:, None] * self.outside.weights).log()
        log = prior - 0.5 * ((image[:, None, None] - mean) ** 2 / variance + (2 * math.pi * variance).log())
        if log[0].numel() == 1:
            return mean, variance, torch.ones_like(log), log[:, 0, 0]
        total = log.flatten(1).logsumexp(1)
        return mean, variance, (log - total[:, None, None]).exp(), total


class Labels(Appearance):
    """Each voxel is of one class."""

    def update(self, image: Tensor, share: Tensor) -> Labels:
        """One step: responsibilities, then each component's weight, mean and variance."""
        belong, _, _ = self._classes(image, share)
        count = self.inside.means.numel()
        parts = []
        for mixture, own in ((self.inside, belong[:, :count]), (self.outside, belong[:, count:])):
            mass, means = _weighted_means(image, own, mixture.means)
            spread = (own * (image[:, None] - means) ** 2).sum(0) / mass
            spread = torch.where(mass > 1e-6, spread, mixture.variances).clamp_min(self.least)
            parts.append(Mixture(mass / mass.sum(), means, spread))
        return replace(self, inside=parts[0], outside=parts[1])

    def means(self, image: Tensor, share: Tensor) -> Tensor:
        """See `Appearance.means`: by responsibilities."""
        belong, _, _ = self._classes(image, share)
        return _weighted_means(image, belong, torch.cat([self.inside.means, self.outside.means]))[1]

    def evidence(self, image: Tensor, share: Tensor) -> Evidence:
        """See `Appearance.evidence`."""
        belong, log_likelihood, slope = self._classes(image, share)
        means = torch.cat([self.inside.means, self.outside.means])
        variances = torch.cat([self.inside.variances, self.outside.variances])
        by_mean = belong * (image[:, None] - means) / variances
        rows = torch.cat([slope[:, None], by_mean], 1)
        return Evidence(float(log_likelihood.sum()), slope, rows)

    def _classes(self, image: Tensor, share: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Responsibilities (N,I+J), log-likelihood (N,) and its derivative by the share of inside (N,)."""
        density = [
            m.weights.log() - 0.5 * ((image[:, None] - m.means) ** 2 / m.variances + (2 * math.pi * m.variances).log())
            for m in (self.inside, self.outside)
        ]
        p = share.clamp(1e-12, 1 - 1e-12)[:, None]
        log = torch.cat([p.log() + density[0], (1 - p).log() + density[1]], 1)
        total = log.logsumexp(1)
        each = [(d.logsumexp(1) - total).exp() for d in density]
        return (log - total[:, None]).exp(), total, each[0] - each[1]


MODELS: dict[str, type[Appearance]] = {"partial-volume": PartialVolume, "labels": Labels}


def _weighted_means(image: Tensor, own: Tensor, old: Tensor) -> tuple[Tensor, Tensor]:
    """Mass and mean (K,) of components by their responsibilities (N,K); one without voxels keeps its old mean."""
    mass = own.sum(0).clamp_min(1e-9)
    return mass, torch.where(mass > 1e-6, (own * image[:, None]).sum(0) / mass, old)


def _spread(image: Tensor, weight: Tensor, count: int, least: float) -> Mixture:
    """Components at evenly spaced quantiles of weighted intensities; one at their mean."""
    if count == 1:
        means = ((weight * image).sum() / weight.sum().clamp_min(1e-12))[None]
    else:
        order = image.argsort()
        rank = weight[order].cumsum(0) / weight.sum().clamp_min(1e-12)
        wanted = (torch.arange(count, device=image.device).double() + 0.5) / count
        means = image[order][torch.searchsorted(rank, wanted).clamp_max(len(image) - 1)]
    nearest = (image[:, None] - means).abs().argmin(1)
    own = torch.nn.functional.one_hot(nearest, count).double() * weight[:, None]
    mass = own.sum(0).clamp_min(1e-9)
    variances = ((own * (image[:, None] - means) ** 2).sum(0) / mass).clamp_min(least)
    return Mixture(mass / mass.sum(), means, variances)
