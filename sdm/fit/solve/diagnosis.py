"""Diagnosis of an answer: did the steps converge, and is there such a shape in the image at all?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool3d, max_pool3d

from sdm.core.grid import Grid
from sdm.fit.model.appearance import Appearance
from sdm.fit.model.prior import Prior
from sdm.fit.solve.solver import Outcome, Point

# An answer is trusted from here on. A right shape explains more than 0.95 of what is around it, the best of wrong
# ones (balls, tubes, blocks) of 0.5 mm voxels less than 0.8: tests/unit/fit/solve/test_no_cochlea.py.
LEAST_EXPLAINED = 0.85
# The mean of 3^3 voxels, which takes noise away, takes away as much of a shape of so few voxels that a block of 0.7 mm
# voxels is explained to 0.89, of 0.95 mm to 0.94. Voxel by voxel blocks are to 0.78 at most (0.9 mm, contrast 8 times
# the noise), right shapes, fitted with a blur of 0.2 for 0.5 mm or 0.5 for 0.2, to 0.80 at least (0.5 mm).
FEW_VOXELS = 125
LEAST_EXPLAINED_BY_VOXEL = 0.8
# A fit to the coarse image that explains less than this is not worth a fine one.
HOPELESS = 0.5
# Difference of inside and outside, in standard deviations of the noise.
LEAST_CONTRAST = 0.7
# Nats that a shape must gain over no shape for each of its unknowns, beyond what the BIC asks.
LEAST_GAIN = 5.0
# A search that stops no further than this from its optimum, in posterior standard deviations, has an answer.
MOST_LEFT = 1.0
# Misfit at the surface, in standard deviations of the noise, from which intervals are told to be too narrow.
MOST_MISFIT = 0.5
# How near to an end of its range a parameter is there.
AT_END = 1e-6
# Half-width of the neighbourhood that has to be explained [mm].
AROUND = 1.0


@dataclass(frozen=True)
class Diagnosis:
    """Evidence for an answer and against it.

    Args:
        converged: The last step was far below the posterior's standard deviations.
        explained: Share of the structure in the shape's neighbourhood that it explains, at most 1: noise is left out.
        contrast: Difference of the mean intensities in standard deviations of the noise.
        gain: Gain in log-likelihood over no shape at all [nats].
        misfit: Root mean square of the residuals of voxels that the surface cuts, less the noise, in standard
            deviations of the noise: 0 where the model describes the image.
        seen: Whether gain and contrast say that there is something.
        problems: Why the answer is not to be trusted, one sentence each; none if it is.
        warnings: What a reader should know of a trusted answer, one sentence each.
    """

    converged: bool
    explained: float
    contrast: float
    gain: float
    misfit: float
    seen: bool
    problems: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def hopeless(self) -> bool:
        """True if finer steps would be a waste of time."""
        return not self.seen or self.explained < HOPELESS

    @property
    def trusted(self) -> bool:
        """True if nothing speaks against the answer."""
        return not self.problems


def diagnose(image: Tensor, grid: Grid, found: Outcome, prior: Prior, names: list[str]) -> Diagnosis:
    """Look at an estimate with the eyes of someone who does not believe it."""
    at, converged = found.point, found.converged
    noise = noise_of(image)
    explained = explained_share(image, grid, at, noise)
    inside, outside = at.appearance.inside, at.appearance.outside
    contrast = abs(inside.mean - outside.mean) / max(noise, 1e-12 + 1e-6 * float(image.abs().max()))
    gain = gain_over_nothing(image, at)
    unknowns = len(at.gradient) + 1 + 3 * len(inside.means)
    needed = unknowns * (0.5 * math.log(image.numel()) + LEAST_GAIN)
    problems = []
    if not converged and not found.left <= MOST_LEFT:
        problems.append(
            "the fit did not converge; its values are unreliable. If the scanner's blur is known, name it "
            "(--blur, FitOptions.blur)"
        )
    seen = math.isfinite(gain) and gain >= needed and contrast >= LEAST_CONTRAST
    if not seen:
        problems.append(
            f"no shape of this family found: log-likelihood gain {gain:.0f}, {needed:.0f} needed; contrast "
            f"{contrast:.2f} times the noise, {LEAST_CONTRAST} needed"
        )
    elif explained < LEAST_EXPLAINED:
        problems.append(
            f"what is seen is not a shape of this family: it explains {explained:.0%} of its neighbourhood "
            f"({LEAST_EXPLAINED:.0%} needed)"
        )
    elif (by_voxel := explained_by_voxel(image, grid, at, noise)) < LEAST_EXPLAINED_BY_VOXEL:
        problems.append(
            f"what is seen is not a shape of this family: voxel by voxel it explains {by_voxel:.0%} of its "
            f"neighbourhood ({LEAST_EXPLAINED_BY_VOXEL:.0%} needed)"
        )
    if _at_border(at.share):
        problems.append("the shape reaches the image's border: take a larger part of the image")
    warnings = at_ends(names, at.state.theta.tolist(), prior.low.tolist(), prior.high.tolist())
    if not converged and found.left <= MOST_LEFT:
        warnings.append(f"the steps stopped {found.left:.2f} posterior standard deviations from the optimum")
    misfit = surface_misfit(image, at, noise)
    if misfit > MOST_MISFIT:
        warnings.append(
            f"the image differs from the model at the surface by {misfit:.1f} times its noise, so the intervals are "
            "too narrow: the scanner's blur may be another (--blur, FitOptions.blur), or intensities uneven"
        )
    return Diagnosis(converged, explained, contrast, gain, misfit, seen, tuple(problems), tuple(warnings))


def at_ends(names: list[str], values: list[float], low: list[float], high: list[float]) -> list[str]:
    """Sentences about parameters that came to an end of their ranges."""
    return [
        f"{name} is at an end of its range, so its interval is one-sided"
        for name, value, least, most in zip(names, values, low, high, strict=True)
        if value - least < AT_END or most - value < AT_END
    ]


def noise_of(image: Tensor) -> float:
    """Standard deviation of white noise, from differences of neighbours, most of which see no edge."""
    differences = torch.cat([image.diff(dim=axis).flatten() for axis in range(3) if image.shape[axis] > 1])
    return float(differences.abs().median()) / 0.67449 / math.sqrt(2)


def explained_share(image: Tensor, grid: Grid, at: Point, noise: float) -> float:
    """Share of the structure around the shape that it explains: both smoothed, and noise taken off."""
    near = _neighbourhood(grid, at)
    if not bool(near.any()):
        return 0.0
    rest = noise**2 / 27
    total, left = (
        float((_smooth(values)[near] ** 2).mean()) - rest
        for values in (image - image[near].mean(), image - _expected(at))
    )
    return 1 - max(0.0, left) / total if total > rest else 0.0


def explained_by_voxel(image: Tensor, grid: Grid, at: Point, noise: float) -> float:
    """That share without the smoothing; 1 where the shape has `FEW_VOXELS`, or noise is more than the structure."""
    near = _neighbourhood(grid, at)
    if float(at.share.sum()) >= FEW_VOXELS or not bool(near.any()):
        return 1.0
    total, left = (
        float((values[near] ** 2).mean()) - noise**2 for values in (image - image[near].mean(), image - _expected(at))
    )
    return 1 - max(0.0, left) / total if total > noise**2 else 1.0


def _expected(at: Point) -> Tensor:
    return at.share * at.appearance.inside.mean + (1 - at.share) * at.appearance.outside.mean


def _neighbourhood(grid: Grid, at: Point) -> Tensor:
    near = (at.share > 0.01).double()[None]
    # Axis by axis: the box of all three at once has hundreds of voxels.
    for axis, spacing in enumerate(grid.spacing):
        reach = [2 * math.ceil(AROUND / spacing) + 1 if axis == own else 1 for own in range(3)]
        near = max_pool3d(near, reach, stride=1, padding=[r // 2 for r in reach])
    return near[0] > 0


def surface_misfit(image: Tensor, at: Point, noise: float) -> float:
    """Residuals of the voxels that the surface cuts, beyond the noise, in standard deviations of the noise."""
    cut = (at.share > 0.05) & (at.share < 0.95)
    if not bool(cut.any()):
        return 0.0
    beyond = float(((image - _expected(at))[cut] ** 2).mean()) - noise**2
    return math.sqrt(max(0.0, beyond)) / max(noise, 1e-12 + 1e-6 * float(image.abs().max()))


def gain_over_nothing(image: Tensor, at: Point) -> float:
    """Gain in log-likelihood over an image without the shape, whose outside has one component more."""
    voxels, share = image.flatten(), at.share.flatten()
    kind: type[Appearance] = type(at.appearance)
    nothing = kind.start(voxels, torch.zeros_like(share), (1, len(at.appearance.outside.means)))
    for _ in range(10):
        nothing = nothing.update(voxels, torch.zeros_like(share))
    without = nothing.evidence(voxels, torch.zeros_like(share)).log_likelihood
    return at.appearance.evidence(voxels, share).log_likelihood - without


def _smooth(values: Tensor) -> Tensor:
    return avg_pool3d(values[None], 3, stride=1, padding=1, count_include_pad=False)[0]


def _at_border(share: Tensor) -> bool:
    faces = [share.select(axis, end) for axis in range(3) for end in (0, -1)]
    return any(bool((face > 0.5).any()) for face in faces)
