"""Fits of any family: its shapes are brought to the size that fits are made for, and the answer back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.grid import Grid
from sdm.fit.model.backend import Backend
from sdm.fit.model.exact import ExactBackend
from sdm.fit.model.scaled_family import ScaledFamily, factor_of, scaled_grid, unscaled
from sdm.fit.solve.estimate_blur import estimate_blur
from sdm.fit.solve.fit_shape import FitOptions, fit_shape
from sdm.fit.solve.formation.estimate import estimate_formation
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import Point
from sdm.shapes import Family

# Of the voxel's longest edge, where no blur is given: what scanners have.
BLUR = 0.5


def fit_family(
    image: Any,
    grid: GridLike,
    family: Family,
    *,
    options: FitOptions | None = None,
    with_blur: bool = False,
    with_formation: bool = False,
    device: torch.device | str | None = None,
    report: Callable[[str, int, Point | None], None] | None = None,
) -> FitResult:
    """Fit any family's parameters and a rigid pose to an image by exact distances.

    Args:
        image: (nx,ny,nz) intensities, cropped to the shape and a little around.
        grid: Where its voxels are, in the family's unit.
        family: Any whose `vertices`, or `reference_vertices`, are plain torch code.
        options: As of `fit_shape`, lengths in the family's unit; by default a blur of half a voxel.
        with_blur: Estimate the blur with the shape; that of the options is where it begins.
        with_formation: Estimate blur, uneven intensities and the noise's correlation with the shape.
        device: Where to compute; by default a GPU if there is one.
        report: As of `fit_shape`; of the steps after that it is not told where they led, but None.

    Returns:
        As `fit_shape`, in the image's lengths.
    """
    factor = factor_of(family)
    backend = ExactBackend(family if factor == 1 else ScaledFamily(family, factor), device)
    return fit_scaled(
        image, grid, backend, factor, options=options, with_blur=with_blur, with_formation=with_formation, report=report
    )


def usual_options(grid: Grid, factor: float, **given: Any) -> FitOptions:
    """Options for an image of shapes that fits see `factor` times as large; what is None counts as not given."""
    usual = {"blur": BLUR * max(grid.spacing), "fine": FitOptions.fine / factor, "shift": FitOptions.shift / factor}
    return FitOptions(**{**usual, **{key: value for key, value in given.items() if value is not None}})


def fit_scaled(
    image: Any,
    grid: GridLike,
    backend: Backend,
    factor: float,
    *,
    options: FitOptions | None = None,
    with_blur: bool = False,
    with_formation: bool = False,
    report: Callable[[str, int, Point | None], None] | None = None,
) -> FitResult:
    """As `fit_family`, by a backend whose lengths are `factor` times those of the image and of the options."""
    grid = as_grid(grid)
    options = usual_options(grid, factor) if options is None else options
    lengths = {name: getattr(options, name) * factor for name in ("blur", "fine", "shift")}
    pose = None if options.pose is None else (options.pose[0], options.pose[1] * factor)
    length = None if options.length is None else options.length * factor
    own = replace(options, pose=pose, length=length, **lengths)
    there = grid if factor == 1 else scaled_grid(grid, factor)
    found = fit_shape(image, there, backend, options=own, report=report)
    told = None if report is None else lambda stage, step: report(stage, step, None)
    if with_formation:
        found = estimate_formation(image, there, backend, found, own, report=told)
    elif with_blur and found.trusted:
        found = estimate_blur(image, there, backend, found, own, report=told)
    blur = None if found.blur is None else (found.blur[0] / factor, found.blur[1] / factor)
    formation = None if found.formation is None or blur is None else replace(found.formation, blur=blur)
    return replace(found, posterior=unscaled(found.posterior, factor), blur=blur, formation=formation)
