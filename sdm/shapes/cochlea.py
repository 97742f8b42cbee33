"""The cochlea family of Wang et al., MIDL 2020: a tapering tube along a rising spiral, four parameters."""

from __future__ import annotations

import math

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.given_values import real
from sdm.errors import MeshError
from sdm.kernels.shapes import cochlea
from sdm.shapes.cochlea_design import CochleaDesign
from sdm.shapes.cochlea_reference import reference_vertices
from sdm.shapes.family import Family, Parameter, as_theta
from sdm.shapes.tube import superellipse, tube
from sdm.shapes.vertex_op import vertex_op

FEWEST, MOST = 500, 4_000_000
# Steps along the tube for each of the cap's cells, and how fast the steps widen towards the apex [1/rad].
STEPS_PER_CELL = 16.7
WIDENING = 0.1

_cochlea_vertices = vertex_op(
    "cochlea_vertices",
    cochlea.cochlea_vertices,
    cochlea.cochlea_gradient,
    (wp.float32, wp.int32, wp.vec2, wp.float32),
)


class Cochlea(Family):
    """Scala-tympani-like tubes; the axis of the spiral is z, lengths are millimetres.

    Args:
        triangles: About how many triangles, 500 to 4,000,000.
        design: The constants that all shapes share.

    Parameters: `a` radius of the spiral at the base [mm], `alpha` height of the wave of the centre line [mm], `b`
    decay of the radius [1/rad], `phi` phase of the wave [rad]. With the turning angle t from 0 (base) to 671 degrees:

    - centre line: `r(t) = a exp(-b t) hook(t)` and `z(t) = rise t + alpha f cos(t - phi - pi)`. The published names
      and ranges are these four; the rest is our reading. The hook is how the real scala leaves the spiral over its
      first 77 degrees (Cohen et al. 1996 also give the spiral another formula there). The wave is not damped by
      itself, so that turns keep their distance; the fade f = s / sqrt(s^2 + 1), s = a exp(-b t) [mm], bounds its slope
      where the spiral gets narrow.
    - sections lie in the half-plane through the axis: superellipses, flat on top and round below, with widths,
      heights and slopes tabled from the real scala, which follow the radius as (s(t) / s_real(t))^(1/3).
    - smooth minima keep a section narrower than 0.85 r (never across the axis) and its heights below 0.9 of half the
      room to the turns above and below (turns never touch), so that no theta of the box makes the surface meet itself.
    - ends are flat.

    Vertices are smooth in theta. Fitted in theta and rigid pose, the family comes within 0.064 mm of the real mean
    scala tympani (mean distance both ways), at a = 3.59, alpha = 0.42, b = 0.140, phi = -0.21; at all corners and 1,000
    random points of the box no surface meets itself. `python -m sdm.bench.fit.cochlea_family` measures both.

    Raises:
        MeshError: A number of triangles out of range.
    """

    name = "cochlea"
    parameters = (
        Parameter("a", 2.0, 5.0, "mm"),
        Parameter("alpha", 0.0, 1.2, "mm"),
        Parameter("b", 0.05, 0.25, "1/rad"),
        Parameter("phi", -math.pi / 4, math.pi / 4, "rad"),
    )

    def __init__(self, triangles: int = 20_000, *, design: CochleaDesign | None = None) -> None:
        if not FEWEST <= real(triangles) <= MOST:
            raise MeshError(f"a cochlea of {triangles!r} triangles was requested; {FEWEST} to {MOST:,} are supported")
        if not isinstance(design, CochleaDesign | None):
            raise MeshError(f"the design is {design!r}; give a CochleaDesign")
        self.design = CochleaDesign() if design is None else design
        # An even number of cells puts a vertex at the middle of each cap.
        cells = 2 * max(1, round(math.sqrt(triangles / (8 * STEPS_PER_CELL + 4)) / 2))
        steps = max(8, round((triangles - 4 * cells * cells) / (8 * cells)))
        body = tube(steps, superellipse(4 * cells, self.design.top, self.design.bottom))
        self.angles = _angles(steps, self.design.end)
        self.triangles = torch.from_numpy(body.faces)
        self._count = len(body.station)
        self._tables = [
            torch.from_numpy(self.design.stations(self.angles).astype(np.float32)),
            torch.from_numpy(body.station),
            torch.from_numpy(body.section.astype(np.float32)),
            torch.from_numpy(self.design.constants().astype(np.float32)),
        ]

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) [mm] for theta (B,4) = (a, alpha, b, phi), differentiable in theta."""
        theta = as_theta(theta, 4, self.name)
        return _cochlea_vertices(theta, self._on(theta.device, "tables", lambda: self._tables), self._count)

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) [mm] for theta (B,4) in theta's type, by plain torch."""
        return reference_vertices(theta, self._on(theta.device, "tables", lambda: self._tables))

    def with_triangles(self, triangles: int) -> Cochlea:
        """The same shapes from meshes of about so many triangles."""
        return Cochlea(triangles, design=self.design)


def _angles(steps: int, end: float) -> np.ndarray:
    share = np.linspace(0, 1, steps + 1)
    return -np.log(1 - share * (1 - math.exp(-WIDENING * end))) / WIDENING
