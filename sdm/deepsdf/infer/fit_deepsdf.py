"""Fit of a DeepSDF to an image or to points: its components first, with intervals, then its whole code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.grid import Grid
from sdm.core.random import generator
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend, factor_of_model
from sdm.deepsdf.infer.fit_code import CodeFit, fit_code
from sdm.deepsdf.infer.fit_code_points import CodePointFit, fit_code_points
from sdm.deepsdf.networks.model import DeepSDF
from sdm.fit.model.scaled_family import scaled_grid
from sdm.fit.solve.diagnosis import MOST_MISFIT, diagnose
from sdm.fit.solve.fit_family import fit_scaled, usual_options
from sdm.fit.solve.fit_points import PointFit, fit_points
from sdm.fit.solve.fit_shape import FitOptions, image_tensor, prior_of
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import Outcome, Point

# Steps on components, of which the whole code takes over.
COMPONENT_STEPS = 15
# Steps of expectation-maximisation for the intensities of a whole code.
EM_STEPS = 10
# Points that are fitted at most: a step's work grows with their square.
MOST_POINTS = 2000


@dataclass(frozen=True, eq=False)
class DeepSDFFit:
    """A DeepSDF in an image.

    Args:
        result: Size, components and pose with intervals; shares of voxels and diagnosis are the whole code's.
        code: The whole code; None where no shape was found, and where the image's formation was estimated.
    """

    result: FitResult
    code: CodeFit | None

    def record(self) -> dict[str, Any]:
        """Everything as plain numbers, for JSON."""
        return {**self.result.record(), **({} if self.code is None else {"code": self.code.record()})}


@dataclass(frozen=True, eq=False)
class DeepSDFPointFit:
    """A DeepSDF at points: size, components and pose with intervals, and the whole code."""

    components: PointFit
    code: CodePointFit


def fit_deepsdf(
    image: Any,
    grid: GridLike,
    model: DeepSDF,
    *,
    options: FitOptions | None = None,
    with_blur: bool = False,
    with_formation: bool = False,
    report: Callable[[str, int, Any], None] | None = None,
) -> DeepSDFFit:
    """Fit size, code and pose of a DeepSDF to an image.

    Args:
        image: (nx,ny,nz) intensities, cropped to the shape and a little around.
        grid: Where its voxels are, in the unit of the training's meshes.
        model: The network with its codes.
        options: As of `fit_family`.
        with_blur: Estimate the blur with the components.
        with_formation: Estimate blur, uneven intensities and the noise's correlation with the components, and fit no
            whole code, which takes intensities to be even.
        report: As of `fit_shape`.

    Size and pose are found with the components along which the training's codes vary most, a dozen; then all numbers
    of the code follow, with size and pose, under the Gaussian of the training's codes. Intervals are of the first.
    """
    grid, factor = as_grid(grid), factor_of_model(model)
    options = usual_options(grid, factor) if options is None else options
    backend = DeepSDFBackend(model, factor)
    first = options if with_formation else replace(options, most_steps=min(options.most_steps, COMPONENT_STEPS))
    result = fit_scaled(
        image, grid, backend, factor, options=first, with_blur=with_blur, with_formation=with_formation, report=report
    )
    if with_formation or result.diagnosis.hopeless:
        return DeepSDFFit(result, None)
    own = options if result.blur is None else replace(options, blur=result.blur[0])
    at_scale = DeepSDFBackend(model)
    code = fit_code(
        image,
        grid,
        at_scale,
        result.state,
        options=own,
        explained=result.diagnosis.explained,
        report=None if report is None else lambda stage, step: report(stage, step, None),
    )
    values = image_tensor(image, grid, model.device)
    return DeepSDFFit(_judged(values, scaled_grid(grid, factor), backend, result, code), code)


def fit_deepsdf_points(
    points: Any, model: DeepSDF, *, turn: float = 0.5, report: Callable[[str, int], None] | None = None
) -> DeepSDFPointFit:
    """Fit size, code and pose of a DeepSDF to points (N,3) of a surface: as `fit_points`, then by the whole code.

    Of more points than a few thousand, which say as much as the network knows, those are taken, at random.
    `report` is called with the stage's name and the number of each step.
    """
    backend = DeepSDFBackend(model)
    given = torch.as_tensor(points)
    if len(given) > MOST_POINTS:
        order = torch.randperm(len(given), generator=generator(0, "points of a fit"))
        given = given[order[:MOST_POINTS].to(given.device)]
    found = fit_points(given, backend, turn=turn, report=report)
    at = given.to(model.device, torch.float64)
    code = fit_code_points(at, backend, found.posterior.state, noise=found.noise, report=report)
    return DeepSDFPointFit(found, code)


def _judged(values: Tensor, grid: Grid, backend: DeepSDFBackend, result: FitResult, code: CodeFit) -> FitResult:
    """The result with share, intensities and diagnosis of the whole code."""
    appearance, voxels, share = result.appearance, values.flatten(), code.share.flatten()
    for _ in range(EM_STEPS):
        appearance = appearance.update(voxels, share)
    none = values.new_zeros(len(result.parameters) + 6)
    point = Point(result.state, appearance, 0.0, none, none, none, code.share)
    outcome = Outcome(point, code.converged, 0.0 if code.converged else float("inf"), code.steps, ())
    prior = prior_of(grid, backend, FitOptions())
    diagnosis = diagnose(values, grid, outcome, prior, [p.name for p in result.parameters])
    alone = result.diagnosis.misfit
    if diagnosis.trusted and alone > MOST_MISFIT:
        warning = (
            f"intervals are of the code's first {len(result.parameters) - 1} components, which leave {alone:.1f} times "
            f"the noise at the surface, where the whole code leaves {diagnosis.misfit:.1f}: they are too narrow"
        )
        diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, warning))
    steps = {**result.steps, "code": code.steps}
    return replace(result, appearance=appearance, share=code.share, diagnosis=diagnosis, steps=steps)
