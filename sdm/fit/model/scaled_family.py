"""Families of another size, or mirrored: fits know lengths of a cochlea, about 10 mm, and its right ear."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.pose import State
from sdm.fit.solve.posterior import Posterior
from sdm.shapes import Family

# Sizes of the middle shape's box, along its longest side, at which fits work as they are.
USUAL, SIZE = (5.0, 25.0), 10.0


class ScaledFamily(Family):
    """The shapes of a family, `factor` times as large; parameters mean what they meant."""

    def __init__(self, family: Family, factor: float) -> None:
        self.family, self.factor = family, factor
        self.parameters, self.triangles = family.parameters, family.triangles
        # As an own attribute: errors name the family.
        vars(self)["name"] = family.name

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) for theta (B,P)."""
        return self.factor * self.family.vertices(theta)

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) in theta's own type."""
        return self.factor * self.family.reference_vertices(theta)

    def with_triangles(self, triangles: int) -> Family | None:
        """The same from meshes of about so many triangles; None where that is no matter of choice."""
        other = self.family.with_triangles(triangles)
        return None if other is None else ScaledFamily(other, self.factor)


class MirroredFamily(Family):
    """The mirror images of a family's shapes: x changes its sign, faces still look outward."""

    def __init__(self, family: Family) -> None:
        self.family = family
        self.parameters, self.triangles = family.parameters, family.triangles.flip(1)
        vars(self)["name"] = family.name

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) for theta (B,P)."""
        found = self.family.vertices(theta)
        return found * found.new_tensor([-1.0, 1.0, 1.0])

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) in theta's own type."""
        found = self.family.reference_vertices(theta)
        return found * found.new_tensor([-1.0, 1.0, 1.0])

    def with_triangles(self, triangles: int) -> Family | None:
        """The same from meshes of about so many triangles; None where that is no matter of choice."""
        other = self.family.with_triangles(triangles)
        return None if other is None else MirroredFamily(other)


def factor_of(family: Family) -> float:
    """The factor by which a family's shapes are of a size that fits are made for; 1 where they are."""
    with torch.no_grad():
        middle = family.from_unit(torch.full((1, len(family.parameters)), 0.5, device="cpu"))
        points = family.vertices(middle)[0]
    size = float((points.amax(0) - points.amin(0)).max())
    return 1.0 if USUAL[0] <= size <= USUAL[1] else 2.0 ** round(math.log2(SIZE / size))


def scaled_grid(grid: Grid, factor: float) -> Grid:
    """A grid `factor` times as large."""
    origin, spacing = ([factor * x for x in values] for values in (grid.origin, grid.spacing))
    return Grid(origin, spacing, grid.shape, grid.direction)


def unscaled(posterior: Posterior, factor: float) -> Posterior:
    """A posterior of scaled shapes in the lengths of the image."""
    state = posterior.state
    own = State(state.theta, state.rotation, state.translation / factor, state.centre / factor)
    scale = torch.ones(len(posterior.covariance), dtype=torch.float64, device=posterior.covariance.device)
    scale[-3:] = 1 / factor
    return Posterior(own, posterior.covariance * scale * scale[:, None])
