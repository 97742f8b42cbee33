"""Gaussian of the training shapes' codes, and the coordinates in which it is a standard one."""

from __future__ import annotations

import torch
from torch import Tensor

# Of few shapes, whose codes leave most directions open.
REST = 0.3


class CodeGaussian:
    """Probabilistic principal components of codes (M. Tipping and C. Bishop, 1999).

    Args:
        codes: (S,D) of the training shapes.
        alone: Variance of each number where the codes do not vary: one shape, or the same ones.
        share: Variance of what the training's codes leave open, all numbers together, as a share of theirs.

    Along the directions in which codes vary the variance is theirs, along all others a share of the mean. The many
    numbers of a code on grids hang together; taken one by one, those of parts that were not seen would stay at the
    mean, and would not follow the others.
    """

    def __init__(self, codes: Tensor, alone: float, share: float = REST) -> None:
        self.mean = codes.mean(0)
        centred = codes - self.mean
        _, sizes, self.axes = torch.linalg.svd(centred, full_matrices=False)
        variances = sizes.square() / max(1, len(centred) - 1)
        rest = share * variances.sum() / centred.shape[1]
        self.rest = torch.where(rest > 0, rest, torch.full_like(rest, alone))
        self.variances = variances + self.rest

    def squared_distance(self, codes: Tensor) -> Tensor:
        """Squared distances (B,) of codes (B,D) from the mean, in units of the variance."""
        away = codes - self.mean
        along = away @ self.axes.T
        others = away.square().sum(1) - along.square().sum(1)
        return (along.square() / self.variances).sum(1) + others.clamp_min(0) / self.rest

    def spread(self, standard: Tensor) -> Tensor:
        """Codes less the mean (D,) of standard coordinates (D,): the root of the covariance, which is symmetric."""
        along = self.axes @ standard
        return self.rest.sqrt() * standard + self.axes.T @ ((self.variances.sqrt() - self.rest.sqrt()) * along)

    def standard(self, away: Tensor) -> Tensor:
        """The inverse of `spread`: standard coordinates (D,) of a code less the mean (D,)."""
        along = self.axes @ away
        return away / self.rest.sqrt() + self.axes.T @ ((1 / self.variances.sqrt() - 1 / self.rest.sqrt()) * along)
