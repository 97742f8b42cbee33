"""The fit: from an image to a shape, its pose and how sure of them one may be."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.given_values import real, two_numbers
from sdm.core.grid import Grid
from sdm.errors import GridError, SDMError
from sdm.fit.model.anchor import Anchored
from sdm.fit.model.appearance import MODELS, Appearance
from sdm.fit.model.backend import Backend, HasError, exact_of, rough_of
from sdm.fit.model.exact import ExactBackend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State, rotation_from_vector
from sdm.fit.model.prior import Prior
from sdm.fit.solve.diagnosis import diagnose
from sdm.fit.solve.initial import all_turns, candidates, coarser, middle_of, of_other_rotations
from sdm.fit.solve.map_error import error_covariance, told
from sdm.fit.solve.posterior import Posterior
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import Outcome, Point, Render, minimise
from sdm.runtime.threads import one_thread_for

LARGEST_IMAGE = 1 << 23
# Points of all voxels, of which a fit takes those near the surface: a large image at the finest that makes sense.
MOST_POINTS = 1e11
SMALLEST_AXIS = 8
# Fits to the coarse image: the logistic's length [mm], and steps of how many posterior standard deviations end them.
COARSE_LENGTH, COARSE_TOLERANCE = 0.1, 1.0
# Where another backend takes over, or a surrogate is anchored, in the same measure: a surrogate is off by as much.
HANDOVER = 0.3
# From this turn on [rad], the search begins at rotations all over SO(3), twice as many are followed.
FAR_TURN = 1.0
# Where it is anchored again.
CLOSE = 0.1


@dataclass(frozen=True, eq=False)
class FitOptions:
    """Options of a fit.

    Args:
        model: "partial-volume": voxels mix, as in a scanner; "labels": each voxel is inside or outside (Wang et al.).
        components: Gaussians inside and outside.
        blur: Standard deviation of the scanner's point spread function [mm].
        length: The reference length l_ref of the logistic [mm]; by default a sixth of `fine`, or for "labels" a
            quarter of the voxel.
        fine: Largest distance between the sample points of a voxel [mm]; "labels" has one point for each voxel.
        pose: The expected pose (rotation matrix, translation of the shape's centre [mm]); by default unturned, in the
            middle of the image.
        turn: How much the rotation may differ from that, standard deviation about each axis [rad]. From 1 on the
            search begins at rotations all over SO(3).
        shift: How much the translation may differ, standard deviation along each axis [mm].
        starts: Best of the plain shapes to start from.
        most_steps: Most steps of a stage.
        tolerance: Converged once the next step is shorter than so many posterior standard deviations.

    Raises:
        SDMError: A number that no fit can be made with.
    """

    model: str = "partial-volume"
    components: tuple[int, int] = (1, 1)
    blur: float = 0.2
    length: float | None = None
    fine: float = 0.15
    pose: tuple[Tensor, Tensor] | None = None
    turn: float = 0.5
    shift: float = 5.0
    starts: int = 3
    most_steps: int = 40
    tolerance: float = 5e-3

    def __post_init__(self) -> None:
        for name in ("fine", "turn", "shift", "length"):
            value = getattr(self, name)
            if value is not None and not 0 < real(value) < math.inf:
                raise SDMError(f"{name} is {value!r}; a positive number is needed")
        if not 0 <= real(self.blur) < math.inf:
            raise SDMError(f"blur is {self.blur!r}; a number of 0 or more is needed")
        if not min(two_numbers(self.components)) >= 1:
            raise SDMError(f"components are {self.components!r}; 1 or more are needed inside and outside")


def fit_shape(
    image: Any,
    grid: GridLike,
    backend: Backend | None = None,
    *,
    finish: Backend | None = None,
    options: FitOptions | None = None,
    report: Callable[[str, int, Point], None] | None = None,
) -> FitResult:
    """Fit a shape family's parameters and a rigid pose to an image.

    Args:
        image: (nx,ny,nz) intensities of any unit, cropped to the shape and a few millimetres around.
        grid: Where its voxels are [mm]: a `Grid`, the path of the image, or another that `sdm.core.as_grid` takes.
        backend: Signed distances of the family; `ExactBackend()` if not given.
        finish: A second backend that takes over at the end: with a surrogate first and `ExactBackend` here the
            estimate is that of the exact backend alone (hybrid). Without it, a surrogate that has an exact backend is
            anchored by it near the end: two exact evaluations in all.
        options: How to fit.
        report: Called with the stage's name, the number of each step and where it led; those of the search for a place
            to begin, in a coarse image, are counted from place to place.

    Returns:
        The maximum of the posterior density and its Laplace approximation. `result.trusted` says whether to believe
        it, `result.require()` raises if not.

    Raises:
        GridError: The image does not fit its grid, or is too small or too large.
        SDMError: The image has values that are not finite, or only one value.

    Method: Wang et al., Medical Image Analysis 2022: a logistic of the signed distance is the prior probability of
    inside, appearance is estimated by expectation-maximisation, shape and pose by Gauss-Newton steps. Ours are the
    partial volume model, SE(3) increments, and the start by cross-correlation.
    """
    begin = time.perf_counter()
    options = FitOptions() if options is None else options
    backend = ExactBackend() if backend is None else backend
    if options.model not in MODELS:
        raise SDMError(f"there is no model called {options.model!r}; use {' or '.join(MODELS)}")
    grid = as_grid(grid)
    values = image_tensor(image, grid, backend.device)
    points = values.numel() * math.prod(max(1.0, s / options.fine) for s in grid.spacing)
    if options.model == "partial-volume" and points > MOST_POINTS:
        raise GridError(
            f"{grid.summary} mm are sampled at {points:.2g} points, {options.fine:g} mm apart, and {MOST_POINTS:.2g} "
            "are the most: is that the image's unit? If so, give a larger distance (fine, --fine) or crop it"
        )
    try:
        with one_thread_for(values.numel(), backend.device):
            found = _fit(values, grid, backend, finish, options, report)
    except torch.linalg.LinAlgError as error:  # pyright: ignore[reportPrivateImportUsage]
        raise SDMError(
            f"the fit came to numbers that are not finite, in an image of {grid.summary} mm: is that its unit?"
        ) from error
    return replace(found, seconds=time.perf_counter() - begin)


def _fit(
    values: Tensor,
    grid: Grid,
    backend: Backend,
    finish: Backend | None,
    options: FitOptions,
    report: Callable[[str, int, Point], None] | None,
) -> FitResult:
    rough = rough_of(backend)
    exact = exact_of(backend) if finish is None else None
    before = _counts(rough, backend, finish or exact)
    prior = prior_of(grid, backend, options)
    names = [p.name for p in backend.parameters]
    small, wide = coarser(values, grid)
    start = _begin(small, wide, rough, prior, options, report)
    steps = {"start": start.steps}
    hopeless = diagnose(small, wide, start, prior, names).hopeless

    def stage(name: str, renderer: Render, start: State, appearance: Appearance, tolerance: float) -> Outcome:
        found = minimise(
            renderer,
            values,
            start,
            appearance,
            prior,
            most_steps=0 if hopeless else options.most_steps,
            tolerance=tolerance,
            report=None if report is None else partial(report, name),
        )
        steps[name] = found.steps
        return found

    renderer = renderer_of(grid, backend, options)
    last = finish is None and exact is None
    close = options.tolerance if last else max(HANDOVER, options.tolerance)
    found = stage("fine", renderer, start.point.state, start.point.appearance, close)
    if finish is not None:
        exactly = renderer_of(grid, finish, options)
        found = stage("finish", exactly, found.point.state, found.point.appearance, options.tolerance)
    elif exact is not None and not hopeless:
        exactly = renderer_of(grid, exact, options)
        for name, tolerance in (("anchored", max(CLOSE, options.tolerance)), ("finish", options.tolerance)):
            anchored = Anchored(renderer, exactly, found.point.state)
            found = stage(name, anchored, found.point.state, found.point.appearance, tolerance)
    at = found.point
    diagnosis = diagnose(values, grid, found, prior, names)
    posterior = Posterior(at.state, torch.linalg.inv(at.curvature))
    if last and isinstance(backend, HasError):
        plain = posterior.deviations[: len(names)]
        if backend.error is not None and diagnosis.seen:
            beyond = error_covariance(values, grid, renderer(at.state), at, backend)
            posterior = Posterior(at.state, posterior.covariance + beyond)
        diagnosis = told(diagnosis, backend, backend.name, plain, posterior.deviations[: len(names)])
    after = _counts(rough, backend, finish or exact)
    return FitResult(
        parameters=backend.parameters,
        posterior=posterior,
        appearance=at.appearance,
        share=at.share,
        objective=at.objective,
        diagnosis=diagnosis,
        evaluations={name: after[name] - before[name] for name in after},
        steps=steps,
        seconds=0.0,
    )


def _begin(
    small: Tensor,
    wide: Grid,
    backend: Backend,
    prior: Prior,
    options: FitOptions,
    report: Callable[[str, int, Point], None] | None,
) -> Outcome:
    """The best of a few fits to a coarse image."""
    far = options.turn >= FAR_TURN
    turns = all_turns(options.turn, small.device) if far else _turns(options.turn, small.device)
    found = candidates(backend, small, wide, prior.pose, turns)
    if far:
        found = of_other_rotations(found)
    # The voxel's own box does most of the blurring.
    renderer = Renderer(wide, backend, blur=options.blur, length=COARSE_LENGTH, fine=max(wide.spacing) / 2)
    best: Outcome | None = None
    numbers = itertools.count(1)
    for candidate in found[: max(1, options.starts * (2 if far else 1))]:
        share = renderer(candidate.state, derivatives=False).share
        appearance = MODELS[options.model].start(small.flatten(), share.flatten(), options.components)
        outcome = minimise(
            renderer,
            small,
            candidate.state,
            appearance,
            prior,
            most_steps=options.most_steps,
            tolerance=COARSE_TOLERANCE,
            report=None if report is None else lambda _, at: report("start", next(numbers), at),
        )
        if best is None or outcome.point.objective < best.point.objective:
            best = outcome
    assert best is not None  # noqa: S101 - there is always a candidate
    return best


def _turns(turn: float, device: torch.device) -> list[Tensor]:
    """Rotations to begin with: one either way about each axis."""
    steps = [s * turn * torch.eye(3)[axis] for axis in range(3) for s in (-0.8, 0.8)]
    return [rotation_from_vector(v.double().to(device)) for v in steps]


def renderer_of(grid: Grid, backend: Backend, options: FitOptions, times: int = 1) -> Renderer:
    """The renderer of a model, with `times` as many sample points along each axis and as short a logistic."""
    if options.model == "labels":
        length, blur, fine = options.length or min(grid.spacing) / 4, 0.0, max(grid.spacing)
    else:
        length, blur, fine = options.length or options.fine / 6, options.blur, options.fine
    return Renderer(grid, backend, blur=blur, length=length / times, fine=fine, times=times)


def prior_of(grid: Grid, backend: Backend, options: FitOptions) -> Prior:
    """The prior of the options, about the expected pose."""
    return Prior.of(backend.parameters, _expected(grid, options, backend), options.turn, options.shift)


def _expected(grid: Grid, options: FitOptions, backend: Backend) -> State:
    rotation, translation = options.pose if options.pose is not None else (torch.eye(3), middle_of(grid))
    middle = torch.tensor([(p.low + p.high) / 2 for p in backend.parameters], dtype=torch.float64)
    return State(
        middle.to(backend.device),
        rotation.to(backend.device, torch.float64),
        translation.to(backend.device, torch.float64),
        backend.centre,
    )


def _counts(*backends: Backend | None) -> dict[str, int]:
    return {b.name: b.evaluations for b in backends if b is not None}


def image_tensor(image: Any, grid: Grid, device: torch.device) -> Tensor:
    """The image (nx,ny,nz) float64 on a device, if it can be fitted."""
    if not isinstance(image, Tensor) and np.asarray(image).dtype.kind not in "buif":
        raise SDMError(f"an image holds numbers, not {np.asarray(image).dtype}: give a tensor or a NumPy array")
    values = image if isinstance(image, Tensor) else torch.as_tensor(np.asarray(image))
    if tuple(values.shape) != grid.shape:
        raise GridError(f"an image of shape {tuple(values.shape)} does not fit a grid of shape {grid.shape}")
    if min(grid.shape) < SMALLEST_AXIS:
        raise GridError(f"an image of shape {grid.shape} is too small to fit: {SMALLEST_AXIS} voxels along each axis")
    if values.numel() > LARGEST_IMAGE:
        raise GridError(f"an image of shape {grid.shape} is too large to fit: crop it to the shape and 2 mm around")
    values = values.to(device, torch.float64)
    if not bool(torch.isfinite(values).all()):
        raise SDMError("the image has values that are not finite: mend or crop it")
    if float(values.max()) == float(values.min()):
        raise SDMError("the image has one value everywhere: there is nothing to fit")
    return values
