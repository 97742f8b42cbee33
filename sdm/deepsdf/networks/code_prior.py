"""Prior of codes: a Gaussian of those of the training shapes."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.deepsdf.networks.model import DeepSDF

# Variance of what the training's codes leave open, as a share of their mean variance.
REST = 0.3


class CodePrior:
    """A Gaussian over codes, as its negative logarithm times two.

    Args:
        model: For the "published" variant the prior is the paper's: mean 0, the same variance along all axes. For the
            "local" one it is fitted to the codes of the training shapes: along the directions in which these vary by as
            much as they do, along all others by a share of the mean (probabilistic principal components: M. Tipping
            and C. Bishop, 1999). The many numbers of a code on grids hang together; taken one by one, those of parts
            that were not seen would stay at the mean, and would not follow the others.
    """

    def __init__(self, model: DeepSDF) -> None:
        self.start = model.codes.mean(0)
        self.learned = model.settings.variant != "published"
        if not self.learned:
            return
        centred = model.codes - self.start
        _, sizes, self._axes = torch.linalg.svd(centred, full_matrices=False)
        variances = sizes.square() / max(1, len(centred) - 1)
        # One training shape, or the same ones, say nothing of how codes vary.
        rest = REST * variances.sum() / centred.shape[1]
        self._rest = torch.where(rest > 0, rest, torch.full_like(rest, model.settings.code_deviation**2))
        self._variances = variances + self._rest

    def __call__(self, codes: Tensor) -> Tensor:
        """Squared distances (B,) of codes (B,D) from the mean, in units of the variance."""
        if not self.learned:
            return codes.square().sum(1)
        away = codes - self.start
        along = away @ self._axes.T
        others = away.square().sum(1) - along.square().sum(1)
        return (along.square() / self._variances).sum(1) + others.clamp_min(0) / self._rest
