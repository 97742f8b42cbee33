"""Statistical shape model as a family: a mean, modes, and a parameter for each in standard deviations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.core.given_values import as_path, real
from sdm.core.mesh import as_tensor
from sdm.errors import MeshError
from sdm.shapes.cube_sphere import cube_surface, unit_sphere
from sdm.shapes.family import Family, Parameter, as_theta

# Deviations that the box of parameters reaches to each side.
LIMIT = 3.0
MOST_MODES = 256


class StatisticalShape(Family):
    """Shapes mean + sum_k theta_k s_k mode_k on fixed faces (the point distribution model of Cootes et al., 1995).

    Args:
        mean: (V,3) vertices of the mean shape, in the meshes' unit.
        modes: (M,V,3) modes of variation, orthonormal as vectors of 3V numbers.
        deviations: (M,) standard deviation of the shapes along each mode, in the meshes' unit, not negative.
        faces: (F,3), counter-clockwise seen from outside.
        limit: The box of parameters: each theta_k from -limit to limit standard deviations.
        facts: What it was made from, ready for JSON; kept in its file.

    The samplers draw theta from the standard normal distribution cut off at the limit, as the model means it: the unit
    cube's points are its quantiles. The corners of the box are in it, but shapes there are far from any that were seen:
    a model with many modes may cut itself there (`sdm family check`).

    Raises:
        MeshError: Arrays that do not fit together, or a number that is not finite.
    """

    name = "shape-model"
    needs_files = True

    def __init__(
        self,
        mean: Any,
        modes: Any,
        deviations: Any,
        faces: Any,
        *,
        limit: float = LIMIT,
        facts: dict[str, Any] | None = None,
    ) -> None:
        mean, modes, deviations = (
            _floats(x, n) for x, n in ((mean, "mean"), (modes, "modes"), (deviations, "deviations"))
        )
        faces = as_tensor(faces, torch.int32, "the faces of a shape model", device=torch.device("cpu"))
        if mean.ndim != 2 or mean.shape[1] != 3 or modes.shape[1:] != mean.shape or deviations.shape != modes.shape[:1]:
            raise MeshError(
                f"a shape model has a mean (V, 3), modes (M, V, 3) and deviations (M,), not {tuple(mean.shape)}, "
                f"{tuple(modes.shape)} and {tuple(deviations.shape)}"
            )
        if not 1 <= len(modes) <= MOST_MODES:
            raise MeshError(f"a shape model of {len(modes)} modes was requested; 1 to {MOST_MODES} are supported")
        if bool((deviations < 0).any()):
            raise MeshError("a standard deviation of a shape model is negative")
        if not 0 < real(limit) < math.inf:
            raise MeshError(f"the limit of a shape model is {limit!r}; give a number of deviations above 0")
        are_rows = faces.ndim == 2 and faces.shape[1] == 3 and len(faces) > 0
        if not (are_rows and 0 <= int(faces.min()) <= int(faces.max()) < len(mean)):
            raise MeshError(f"the faces of a shape model are (F, 3) numbers of its {len(mean)} vertices")
        self.parameters = tuple(Parameter(f"mode{k + 1}", -float(limit), float(limit), "sd") for k in range(len(modes)))
        self.triangles = faces
        self.mean, self.modes, self.deviations, self.limit = mean, modes, deviations, float(limit)
        self.facts = {} if facts is None else facts
        self._tables = [mean.reshape(-1), (modes * deviations[:, None, None]).reshape(len(modes), -1)]

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) float32 for theta (B,M) in standard deviations, differentiable in theta."""
        return self._sum(as_theta(theta, len(self.parameters), self.name))

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) in theta's own type."""
        return self._sum(theta)

    def _sum(self, theta: Tensor) -> Tensor:
        mean, scaled = (table.to(theta.dtype) for table in self._on(theta.device, "modes", lambda: self._tables))
        # Mode by mode: the bits of a matrix product depend on how many shapes there are in the batch.
        points = mean.expand(theta.shape[0], -1)
        for mode, weight in zip(scaled, theta.unbind(1), strict=True):
            points = torch.addcmul(points, weight[:, None], mode)
        return points.reshape(theta.shape[0], len(self.mean), 3)

    def from_unit(self, unit: Tensor) -> Tensor:
        """theta (B,M) for points (B,M) of the unit cube, which are quantiles of the cut-off normal distribution."""
        edge = 0.5 * math.erfc(self.limit / math.sqrt(2))
        # In float64, whose normal quantiles are good to the ends.
        return torch.special.ndtri(edge + unit.double() * (1 - 2 * edge)).clamp(-self.limit, self.limit).to(unit.dtype)

    def to_unit(self, theta: Tensor) -> Tensor:
        """Points (B,M) of the unit cube for theta (B,M)."""
        edge = 0.5 * math.erfc(self.limit / math.sqrt(2))
        return ((torch.special.ndtr(theta.double()) - edge) / (1 - 2 * edge)).clamp(0, 1).to(theta.dtype)

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest x, y, z (3,) over the whole box: each is reached in a corner of it."""
        reach = self.limit * self._tables[1].abs().sum(0).reshape(-1, 3)
        return (self.mean - reach).amin(0), (self.mean + reach).amax(0)

    def project(self, vertices: Tensor) -> Tensor:
        """theta (B,M) of the shapes nearest to vertices (B,V,3) in correspondence, not cut off at the limit."""
        mean, modes, deviations = self._on(
            vertices.device, "project", lambda: [self.mean.reshape(-1), self.modes.flatten(1), self.deviations]
        )
        return (vertices.flatten(1) - mean) @ modes.T / deviations.clamp_min(1e-30)

    def truncated(self, modes: int) -> StatisticalShape:
        """The model of the first `modes` modes alone.

        Raises:
            MeshError: It has not so many, or none is asked for.
        """
        if not 1 <= modes <= len(self.modes):
            raise MeshError(f"{modes} modes of {len(self.modes)} were requested")
        kept = (self.mean, self.modes[:modes], self.deviations[:modes], self.triangles)
        return StatisticalShape(*kept, limit=self.limit, facts=self.facts)

    def save(self, path: str | Path) -> None:
        """Write the model as .npz: plain arrays, no pickle."""
        from sdm.shapes.models.model_file import save_model

        save_model(self, as_path(path))

    @classmethod
    def load(cls, path: str | Path) -> StatisticalShape:
        """The model of a file that `save` or `sdm shape-model build` wrote.

        Raises:
            FormatError: It cannot be read, or is something else.
        """
        from sdm.shapes.models.model_file import load_model

        return load_model(as_path(path))

    @classmethod
    def example(cls) -> StatisticalShape:
        """Ellipsoids about the unit sphere, whose three half-lengths vary by a tenth."""
        cube, faces = cube_surface(7)
        points = torch.from_numpy(unit_sphere(cube).copy()).float()
        modes = torch.zeros(3, *points.shape, device="cpu")
        for axis in range(3):
            modes[axis, :, axis] = points[:, axis]
        lengths = modes.flatten(1).norm(dim=1)
        return cls(points, modes / lengths[:, None, None], 0.1 * lengths, faces)


def _floats(values: Any, name: str) -> Tensor:
    tensor = as_tensor(values, torch.float32, f"the {name} of a shape model", device=torch.device("cpu")).detach()
    if not bool(tensor.isfinite().all()):
        raise MeshError(f"the {name} of a shape model holds a number that is not finite")
    return tensor
