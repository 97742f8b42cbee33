"""Intensities that change smoothly over the image: a polynomial inside and one outside."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

# How far a coefficient may be from even intensities: standard deviation, as a share of the contrast.
UNEVEN = 0.5


def polynomials(shape: tuple[int, int, int], degree: int, device: torch.device) -> Tensor:
    """(N,F) products of powers of the voxel's place, each axis from -1 to 1, up to a total degree; the first is 1."""
    axes = [torch.linspace(-1, 1, n, dtype=torch.float64, device=device) for n in shape]
    x, y, z = torch.meshgrid(*axes, indexing="ij")
    powers = [p for p in itertools.product(range(degree + 1), repeat=3) if sum(p) <= degree]
    powers.sort(key=sum)
    return torch.stack([(x**i * y**j * z**k).flatten() for i, j, k in powers], 1)


@dataclass(frozen=True, eq=False)
class Intensities:
    """Expected intensities of a voxel that holds a share p of inside: p B u + (1 - p) B v.

    Args:
        basis: (N,F) polynomials B.
        coefficients: (2F,) u, then v.
        variances: Of the noise, inside and outside.
        least: Least variance.
    """

    basis: Tensor
    coefficients: Tensor
    variances: tuple[float, float]
    least: float

    def design(self, share: Tensor) -> Tensor:
        """(N,2F) derivatives by the coefficients at a share of inside (N,)."""
        return torch.cat([share[:, None] * self.basis, (1 - share)[:, None] * self.basis], 1)

    def contrast(self) -> Tensor:
        """(N,) inside less outside."""
        inside, outside = self.coefficients.chunk(2)
        return self.basis @ (inside - outside)

    def variance(self, share: Tensor) -> Tensor:
        """(N,) variance of the noise."""
        return share * self.variances[0] + (1 - share) * self.variances[1]

    def precision(self) -> Tensor:
        """(2F,) prior precision of the coefficients about even intensities."""
        count = self.basis.shape[1]
        contrast = (self.coefficients[0] - self.coefficients[count]).abs().clamp_min(1e-12)
        found = torch.full((2 * count,), 1.0, dtype=torch.float64, device=self.basis.device) / (UNEVEN * contrast) ** 2
        found[0] = found[count] = 0.0
        return found

    def fitted(self, voxels: Tensor, share: Tensor) -> Intensities:
        """Coefficients by weighted least squares, the noise's variances held."""
        design, weight = self.design(share), 1 / self.variance(share)
        normal = (design * weight[:, None]).T @ design + self.precision().diag()
        normal = normal + 1e-12 * normal.diagonal().max() * torch.eye(len(normal), device=normal.device).double()
        found = torch.linalg.solve(normal, design.T @ (weight * voxels))
        return Intensities(self.basis, found, self.variances, self.least)

    def with_noise(self, voxels: Tensor, share: Tensor) -> Intensities:
        """Variances as moments of the residuals, coefficients held."""
        square = (voxels - self.design(share) @ self.coefficients) ** 2
        pair = [float((w * square).sum() / w.sum().clamp_min(1e-12)) for w in (share, 1 - share)]
        return Intensities(
            self.basis, self.coefficients, (max(pair[0], self.least), max(pair[1], self.least)), self.least
        )
