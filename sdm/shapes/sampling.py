"""Points of the unit cube: each a pure function of a seed and its own number.

- `uniform`: Philox4x32-10, a counter-based generator: independent numbers.
- `chebyshev`: independent too, denser towards faces and corners.
- `sobol`: a Sobol sequence under a random shift of its bits: evenly spread, so better for fitting smooth functions.
- `grid`: the tensor grid.

The same numbers come out on every device, for every split into batches.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from functools import cache

import torch
import warp as wp
from torch import Tensor

from sdm.core.given_values import whole
from sdm.errors import MeshError
from sdm.kernels.shapes import counter_random
from sdm.runtime.torch_warp import as_warp, on_current_stream

LARGEST_GRID = 1 << 28


def draw(sampler: str, seed: int, index: Tensor, width: int) -> Tensor:
    """Points (B,width) float32 of the sampler with this name: "uniform", "sobol" or "chebyshev".

    Raises:
        MeshError: There is no sampler of that name.
    """
    check_sampler(sampler)
    return SAMPLERS[sampler](seed, index, width)


def check_sampler(sampler: str) -> None:
    """Refuse another name than a sampler's.

    Raises:
        MeshError: It is one.
    """
    if not isinstance(sampler, str) or sampler not in SAMPLERS:
        raise MeshError(f"there is no sampler called {sampler!r}; use {', '.join(SAMPLERS)}")


def uniform(seed: int, index: Tensor | Sequence[int], width: int) -> Tensor:
    """Independent uniform numbers in [0,1), multiples of 2^-24.

    Args:
        seed: Any whole number of 64 bits.
        index: (B,) int64 numbers of the samples, 0 or more.
        width: Numbers for each sample.

    Returns:
        (B,width) float32 on the index's device.
    """
    numbers, width = as_index(index), _width(width, 0)
    values = torch.empty(numbers.shape[0], width, dtype=torch.float32, device=numbers.device)
    if values.numel():
        with on_current_stream(values, numbers) as device:
            counter_random.fill_uniform(_seed(seed), as_warp(numbers, wp.int64), as_warp(values, wp.float32), device)
    return values


def sobol(seed: int, index: Tensor | Sequence[int], width: int) -> Tensor:
    """Points of a Sobol sequence in [0,1), its bits shifted at random by the seed.

    Args:
        seed: Any whole number of 64 bits.
        index: (B,) int64 places in the sequence, 0 or more. After 2^30 the sequence starts anew, shifted otherwise.
        width: Axes, at most 21,201.

    Returns:
        (B,width) float32 on the index's device.

    Direction numbers of Joe and Kuo, SIAM Journal on Scientific Computing 30, 2008. Any 2^m points that start at a
    multiple of 2^m are as evenly spread as without the shift.
    """
    numbers, width = as_index(index), _width(width, 0)
    values = torch.empty(numbers.shape[0], width, dtype=torch.float32, device=numbers.device)
    if values.numel():
        directions = _directions(width, numbers.device)
        with on_current_stream(values, numbers, directions) as device:
            counter_random.fill_sobol(
                _seed(seed),
                as_warp(numbers, wp.int64),
                as_warp(directions, wp.int64),
                as_warp(values, wp.float32),
                device,
            )
    return values


def chebyshev(seed: int, index: Tensor | Sequence[int], width: int) -> Tensor:
    """Independent numbers in [0,1] with density 1 / (pi sqrt(x (1 - x))): denser at both ends.

    Args and result as of `uniform`.

    The density for which fits of smooth functions by polynomials are stable with the fewest samples (Cohen and
    Migliorati, SMAI Journal of Computational Mathematics 2017); uniform samples leave the corners of a box to chance.
    """
    return ((1 - torch.cos(math.pi * uniform(seed, index, width).double())) / 2).float()


SAMPLERS: dict[str, Callable[[int, Tensor, int], Tensor]] = {
    "uniform": uniform,
    "sobol": sobol,
    "chebyshev": chebyshev,
}


def grid(per_axis: int, width: int) -> Tensor:
    """All points (per_axis^width, width) of the tensor grid over [0,1]^width, ends included; the last axis runs first.

    Raises:
        MeshError: Fewer than 2 points for each axis, or more than 2^28 in all.
    """
    count = whole(per_axis, 2)
    if count is None:
        raise MeshError(f"a grid of {per_axis!r} points for each axis has no width; give 2 or more")
    width = _width(width, 1)
    if width * math.log2(count) > math.log2(LARGEST_GRID):
        raise MeshError(f"a grid of {count} points for each of {width} axes is too large: use a random sampler")
    axis = torch.linspace(0, 1, count, dtype=torch.float32, device="cpu")
    return torch.cartesian_prod(*[axis] * width).reshape(-1, width)


def as_index(index: Tensor | Sequence[int]) -> Tensor:
    """Sample numbers as contiguous (B,) int64."""
    try:
        numbers = index if isinstance(index, Tensor) else torch.as_tensor(list(index), dtype=torch.int64)
    except (TypeError, ValueError, RuntimeError):
        raise MeshError(f"sample numbers are {type(index).__name__}; give a list of whole numbers, or (B,)") from None
    if numbers.ndim != 1 or numbers.dtype.is_floating_point:
        raise MeshError(f"sample numbers have shape {tuple(numbers.shape)} and type {numbers.dtype}; (B,) whole needed")
    return numbers.to(torch.int64).contiguous()


def _seed(seed: int) -> int:
    try:
        return operator.index(seed) & (2**64 - 1)
    except TypeError:
        raise MeshError(f"the seed is {seed!r}; give a whole number") from None


def _width(width: int, least: int) -> int:
    """Numbers of a sample.

    Raises:
        MeshError: It is no whole number from `least` on.
    """
    found = whole(width, least)
    if found is None:
        raise MeshError(f"{width!r} numbers a sample were requested; give {least} or more")
    return found


@cache
def _directions(width: int, device: torch.device) -> Tensor:
    engine = torch.quasirandom.SobolEngine(width)
    return engine.sobolstate.to(dtype=torch.int64, device=device).contiguous()
