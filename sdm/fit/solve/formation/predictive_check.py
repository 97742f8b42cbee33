"""Posterior predictive check: are residuals at the surface what the noise elsewhere would give?"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sdm.fit.solve.formation.noise_correlation import Lag, shifted


def predictive_p(residual: Tensor, near: Tensor, unknowns: int, lags: dict[Lag, float]) -> tuple[float, float]:
    """The p-value of two discrepancies at the surface, and the mean square there over that elsewhere.

    Args:
        residual: (nx,ny,nz) residuals in standard deviations of the noise.
        near: (nx,ny,nz) voxels that the surface cuts or touches.
        unknowns: Unknowns that were fitted to them.
        lags: Correlations of the noise.

    Returns:
        p: How often noise of the same correlation and tails would give as large a discrepancy; small where the model
            does not describe the image. Discrepancies are the mean square and the correlation of neighbours, each
            against the voxels away from the surface (Gelman, Meng and Stern 1996); the smaller p of the two, doubled.
        excess: The ratio of mean squares, the unknowns taken off; 1 where the model holds.
    """
    far = ~near
    count, others = int(near.sum()), int(far.sum())
    if min(count - unknowns, others) < 30:
        return 1.0, 1.0
    # Squares are correlated by the square of the noise's correlation.
    widening = 1 + 2 * sum(value**2 for value in lags.values())
    square = residual**2
    base, spread = float(square[far].mean()), float(square[far].std())
    excess = float(square[near].sum()) / (count - unknowns) / max(base, 1e-300)
    error = spread * math.sqrt(widening * (1 / count + 1 / others))
    first = (excess - 1) * base / max(error, 1e-300)
    second = _neighbours(residual, near, widening)
    return min(1.0, 2 * min(_tail(first), _tail(second))), excess


def _neighbours(residual: Tensor, near: Tensor, widening: float) -> float:
    """Excess correlation of neighbours at the surface over elsewhere, in its standard deviations."""
    beside, away = [], []
    for lag in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        one, other = shifted(residual, lag)
        both = torch.logical_and(*shifted(near, lag))
        neither = ~torch.logical_or(*shifted(near, lag))
        beside.append((one * other)[both])
        away.append((one * other)[neither])
    there, here = torch.cat(away), torch.cat(beside)
    if min(len(there), len(here)) < 30:
        return 0.0
    error = float(there.std()) * math.sqrt(widening * (1 / len(here) + 1 / len(there)))
    return float(here.mean() - there.mean()) / max(error, 1e-300)


def _tail(sigmas: float) -> float:
    return 0.5 * math.erfc(sigmas / math.sqrt(2))
