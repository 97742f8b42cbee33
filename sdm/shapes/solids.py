"""Cuboids, rhomboids, ellipsoids and cylinders of random size and rotation, as in Juhl et al., MIDL 2019."""

from __future__ import annotations

import math

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.given_values import real, two_numbers
from sdm.errors import MeshError
from sdm.kernels.shapes import solids
from sdm.kernels.shapes.solids import CUBOID, CYLINDER, ELLIPSOID, RHOMBOID, SLOTS
from sdm.shapes.cube_sphere import cube_surface, unit_cylinder, unit_sphere
from sdm.shapes.family import Family, Parameter, as_theta
from sdm.shapes.solids_reference import reference_vertices
from sdm.shapes.vertex_op import vertex_op

FEWEST, MOST = 12, 4_000_000
KINDS = ("cuboid", "rhomboid", "ellipsoid", "cylinder")
ROTATION = ("u1", "u2", "u3")
SHIFT = ("shift_x", "shift_y", "shift_z")
# What float32 may put a vertex out of place by, as a share of how far it is.
ROUNDING = 1e-6

_solids_vertices = vertex_op(
    "solids_vertices",
    solids.solids_vertices,
    solids.solids_gradient,
    (wp.vec3, wp.int32, wp.float32),
)


class _Solids(Family):
    """Solids on one topology, a cube's surface cut into squares; `slots[kind]` names each slot's parameter."""

    def __init__(
        self, slots: dict[int, dict[str, str]], ranges: dict[str, Parameter], kind: int, triangles: int, shift: float
    ) -> None:
        if not FEWEST <= real(triangles) <= MOST:
            raise MeshError(f"a {self.name} of {triangles!r} triangles was wanted; {FEWEST} to {MOST:,} are supported")
        if not 0 <= real(shift) < math.inf:
            raise MeshError(f"the largest shift of a {self.name} is {shift!r}; give a length of at least 0")
        ranges = dict(ranges)
        for name in ROTATION:
            ranges[name] = Parameter(name, 0.0, 1.0)
        if shift > 0:
            for name in SHIFT:
                ranges[name] = Parameter(name, -shift, shift, "length")
        self.parameters = tuple(ranges.values())
        order = {name: column for column, name in enumerate(ranges)}
        column = np.full((len(KINDS), len(SLOTS)), -1, dtype=np.int32)
        for k in range(len(KINDS)):
            names = {**{s: s for s in (*ROTATION, *SHIFT, "kind")}, **slots.get(k, {})}
            for s, slot in enumerate(SLOTS):
                column[k, s] = order.get(names.get(slot, ""), -1)
        default = np.zeros(len(SLOTS), dtype=np.float32)
        default[0] = kind

        cube, faces = cube_surface(max(1, round(math.sqrt(triangles / 12))))
        unit = np.stack([cube, cube, unit_sphere(cube), unit_cylinder(cube)])
        self.triangles = torch.from_numpy(faces)
        self._count = len(cube)
        self._tables = [
            torch.from_numpy(unit.astype(np.float32)),
            torch.from_numpy(column),
            torch.from_numpy(default),
        ]

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest x, y, z (3,) over the whole box of parameters: reached, but for rounding.

        A solid's farthest point may turn to any axis.
        """
        # The largest of each kind, in its own frame: half-lengths and shears at their upper ends.
        own = [
            [0.0 if p.name in (*ROTATION, *SHIFT) else k + 0.5 if p.name == "kind" else p.high for p in self.parameters]
            for k in range(len(KINDS))
        ]
        shift = max((p.high for p in self.parameters if p.name in SHIFT), default=0.0)
        with torch.no_grad():
            points = self.vertices(torch.tensor(own, dtype=torch.float32, device="cpu"))
        reach = ((points.norm(dim=-1).amax() + shift) * (1 + ROUNDING)).expand(3)
        return -reach, reach

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) for theta (B,P), differentiable in theta (not in which solid it is)."""
        theta = as_theta(theta, len(self.parameters), self.name)
        return _solids_vertices(theta, self._on(theta.device, "tables", lambda: self._tables), self._count)

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) for theta (B,P) by plain torch, in theta's own type."""
        return reference_vertices(theta, self._on(theta.device, "tables", lambda: self._tables))


def _lengths(sizes: tuple[float, float], *names: str) -> dict[str, Parameter]:
    low, high = two_numbers(sizes)
    if not 0 < low < high < math.inf:
        raise MeshError(f"the half-lengths {sizes!r} are no range; give two lengths, 0 < low < high")
    return {name: Parameter(name, low, high, "length") for name in names}


def _shears(shear: float) -> dict[str, Parameter]:
    if not 0 < real(shear) < math.inf:
        raise MeshError(f"the largest shear is {shear!r}; give a positive number")
    return {name: Parameter(name, -shear, shear) for name in ("shear_xy", "shear_xz", "shear_yz")}


_AXES = {"x": "x", "y": "y", "z": "z"}
_SHEARED = {**_AXES, "shear_xy": "shear_xy", "shear_xz": "shear_xz", "shear_yz": "shear_yz"}
_ROUND = {"x": "x", "y": "x", "z": "z"}


class Cuboid(_Solids):
    """Cuboids about the origin.

    Args:
        sizes: Least and greatest half-length of an edge, any unit of length.
        triangles: About how many triangles (12 times a square number).
        shift: Largest shift of the centre along each axis; 0 leaves it at the origin, without parameters.

    Parameters: half-lengths `x`, `y`, `z`; `u1`, `u2`, `u3` in (0,1) give a rotation, uniformly (Shoemake 1992).

    Raises:
        MeshError: A number of triangles or a range that makes no sense.
    """

    name = "cuboid"

    def __init__(self, *, sizes: tuple[float, float] = (0.2, 0.8), triangles: int = 5_000, shift: float = 0.0) -> None:
        super().__init__({CUBOID: _AXES}, _lengths(sizes, "x", "y", "z"), CUBOID, triangles, shift)


class Rhomboid(_Solids):
    """Parallelepipeds: a `Cuboid` under a shear, `x += shear_xy y + shear_xz z`, `y += shear_yz z`, then rotated.

    Args as of `Cuboid`, and `shear`, the largest of each of the three shears.
    """

    name = "rhomboid"

    def __init__(
        self,
        *,
        sizes: tuple[float, float] = (0.2, 0.8),
        shear: float = 0.7,
        triangles: int = 5_000,
        shift: float = 0.0,
    ) -> None:
        ranges = {**_lengths(sizes, "x", "y", "z"), **_shears(shear)}
        super().__init__({RHOMBOID: _SHEARED}, ranges, RHOMBOID, triangles, shift)


class Ellipsoid(_Solids):
    """Ellipsoids about the origin. Args and parameters as of `Cuboid`: the half-lengths are the half-axes."""

    name = "ellipsoid"

    def __init__(self, *, sizes: tuple[float, float] = (0.2, 0.8), triangles: int = 5_000, shift: float = 0.0) -> None:
        super().__init__({ELLIPSOID: _AXES}, _lengths(sizes, "x", "y", "z"), ELLIPSOID, triangles, shift)


class Cylinder(_Solids):
    """Circular cylinders about the origin: radius `x`, half-length `z`. Args as of `Cuboid`."""

    name = "cylinder"

    def __init__(self, *, sizes: tuple[float, float] = (0.2, 0.8), triangles: int = 5_000, shift: float = 0.0) -> None:
        super().__init__({CYLINDER: _ROUND}, _lengths(sizes, "x", "z"), CYLINDER, triangles, shift)


class GeometricShapes(_Solids):
    """Cuboids, rhomboids, ellipsoids and cylinders in one family, on the same faces.

    Args as of `Rhomboid`. Parameters: `kind` in (0,4), whose whole part chooses the solid in that order; half-lengths
    `x`, `y`, `z` (a cylinder's radius is `x`, and `y` does nothing); the three shears (only a rhomboid's count);
    `u1`, `u2`, `u3` for the rotation.
    """

    name = "geometric-shapes"

    def __init__(
        self,
        *,
        sizes: tuple[float, float] = (0.2, 0.8),
        shear: float = 0.7,
        triangles: int = 5_000,
        shift: float = 0.0,
    ) -> None:
        slots = {CUBOID: _AXES, RHOMBOID: _SHEARED, ELLIPSOID: _AXES, CYLINDER: _ROUND}
        kind = {"kind": Parameter("kind", 0.0, float(len(KINDS)))}
        super().__init__(slots, {**kind, **_lengths(sizes, "x", "y", "z"), **_shears(shear)}, 0, triangles, shift)
