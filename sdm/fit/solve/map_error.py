"""Error of a model's maps in a posterior: what a fit through a surrogate alone does not know of itself.

Residuals tell the noise, not that every map of the model is a little wrong near the surface. To first order an error
e [mm] at a voxel moves the estimate by A e, where A is the inverse of the information times the voxel's own part of it.
Of e only its root mean square is known. It is taken to be the same all over a patch of the surface and independent
between patches, which are wider than the errors of trained networks hang together (about two voxels of their grid), as
their derivatives, which steps follow, are off too; and beside that the same all over the surface.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.backend import HasError
from sdm.fit.model.partial_volume import Rendered
from sdm.fit.solve.diagnosis import Diagnosis
from sdm.fit.solve.solver import Point

# Above this ratio of deviations with the error to those without, it is worth a word.
WORTH_A_WORD = 1.1


def error_covariance(image: Tensor, grid: Grid, rendered: Rendered, at: Point, backend: HasError) -> Tensor:
    """Covariance (P+6,P+6) float64 of an estimate by the error of the maps that it is made through.

    Args:
        image: (nx,ny,nz) float64 intensities.
        grid: Where its voxels are.
        rendered: The estimate's shares of inside, with derivatives.
        at: The estimate.
        backend: Source of the maps, with a known error.
    """
    assert rendered.by_step is not None  # noqa: S101 - for the type checker
    assert backend.error is not None  # noqa: S101 - for the type checker
    by_step = rendered.by_step.flatten(1)
    near = (by_step != 0).any(0).nonzero()[:, 0]
    jacobian = by_step[:, near].double()
    unknowns = len(jacobian)
    evidence = at.appearance.evidence(image.flatten(), rendered.share.flatten()).rows[near]
    rows = torch.cat([jacobian.T * evidence[:, :1], evidence[:, 1:]], 1)
    # The last three increments move the shape: together as much as the surface does, along its normal.
    slope = jacobian[-3:].norm(dim=0)
    moved = torch.linalg.solve(at.full, rows.T)[:unknowns] * (evidence[:, 0] * slope)
    places = at.state.to_shape(grid.points().reshape(-1, 3)[near.cpu()].to(image))
    _, patch = torch.unique((places / backend.patch).floor().long(), dim=0, return_inverse=True)
    together = moved.new_zeros(unknowns, int(patch.max()) + 1).index_add_(1, patch, moved)
    together = torch.cat([together, together.sum(1, keepdim=True)], 1)
    return backend.error**2 * together @ together.T


def told(diagnosis: Diagnosis, backend: HasError, name: str, without: Tensor, deviations: Tensor) -> Diagnosis:
    """The diagnosis, with a word about the error of the maps.

    Args:
        diagnosis: Of a fit that ended on the maps alone.
        backend: Source of the maps.
        name: Of the source.
        without: (P,) deviations of the shape's parameters by the image alone.
        deviations: (P,) with the error.
    """
    if backend.error is None:
        problem = (
            f"nobody says how far the maps of {name} are off, so the intervals hold nothing of that: name their error "
            "(GridBackend's error), or an exact backend (exact, finish)"
        )
        return replace(diagnosis, problems=(*diagnosis.problems, problem))
    times = float((deviations / without).max())
    if times < WORTH_A_WORD:
        return diagnosis
    warning = (
        f"the maps of {name} are {backend.error:.2g} mm off near the surface, which makes the intervals up to "
        f"{times:.1f} times as wide as the image's noise does: an exact backend (exact, finish) takes it out"
    )
    return replace(diagnosis, warnings=(*diagnosis.warnings, warning))
