"""Autocorrelation of noise from residuals, and the covariance of least squares under it."""

from __future__ import annotations

import itertools
import math

from torch import Tensor

# Largest lag along an axis [voxels], and how many standard deviations of white noise's own a lag must stand out.
MOST_LAG, STANDS_OUT = 3, 3.0

Lag = tuple[int, int, int]


def autocorrelation(residual: Tensor) -> dict[Lag, float]:
    """Correlations of residuals (nx,ny,nz) of unit variance at the lags where they are not chance, 0 left out.

    Of each pair of opposite lags one is there. What stands out by less than `STANDS_OUT` standard deviations is taken
    for 0: hundreds of small wrong correlations would add up to a wrong covariance.
    """
    centred = residual - residual.mean()
    power = float((centred**2).mean())
    found: dict[Lag, float] = {}
    if power == 0:
        return found
    for lag in _half_space():
        if any(abs(step) >= size for step, size in zip(lag, residual.shape, strict=True)):
            continue
        one, other = shifted(centred, lag)
        value = float((one * other).mean()) / power
        if abs(value) > STANDS_OUT / math.sqrt(one.numel()):
            found[lag] = value
    return found


def effective_share(lags: dict[Lag, float]) -> float:
    """Independent voxels for each voxel, as the variance of a mean has it: 1 for white noise."""
    return 1 / max(1.0, 1 + 2 * sum(lags.values()))


def correlated_information(rows: Tensor, lags: dict[Lag, float]) -> Tensor:
    """(K,K) covariance of the score under correlated noise: J^T R J for J^T given as images (K,nx,ny,nz).

    The rows are derivatives in standard deviations of the noise. With the information A = J^T J, least squares has the
    covariance inv(A) (J^T R J) inv(A) (White 1980, Newey and West 1987).
    """
    flat = rows.flatten(1)
    total = flat @ flat.T
    for lag, value in lags.items():
        one, other = shifted(rows, lag)
        cross = one.flatten(1) @ other.flatten(1).T
        total += value * (cross + cross.T)
    return total


def shifted(values: Tensor, lag: Lag) -> tuple[Tensor, Tensor]:
    """The parts of images (...,nx,ny,nz) that lie over each other at a lag."""
    one = [slice(max(0, -step), min(n, n - step)) for step, n in zip(lag, values.shape[-3:], strict=True)]
    other = [slice(max(0, step), min(n, n + step)) for step, n in zip(lag, values.shape[-3:], strict=True)]
    return values[(..., *one)], values[(..., *other)]


def _half_space() -> list[Lag]:
    every = itertools.product(range(-MOST_LAG, MOST_LAG + 1), repeat=3)
    return [(x, y, z) for x, y, z in every if (x, y, z) > (0, 0, 0)]
