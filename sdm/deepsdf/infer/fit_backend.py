"""A DeepSDF as what `sdm.fit` takes distances from: the size of a shape and its code are fitted with the pose."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.deepsdf.infer.isosurface import decode_mesh
from sdm.deepsdf.networks.model import DeepSDF
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import SDMError
from sdm.fit.model.backend import Distances
from sdm.runtime.threads import threads
from sdm.shapes import Parameter

# Components of the training's codes: as many as hold this share of their variance, at most so many.
KEPT, MOST = 0.99, 12
# Deviations of a component on each side of the mean, and of the least and largest training shape's size.
LIMIT, SMALLER, LARGER = 3.0, 0.8, 1.25
# How far the network may be off near the surface, in radii of the sphere.
SLACK = 0.02
# Points that are differentiated at a time: each sees all components.
POINTS = 1 << 15
# Radius at which fits work as they are.
USUAL_RADIUS = 5.0


class DeepSDFBackend:
    """Distances of the shapes that a DeepSDF knows.

    Args:
        model: The network, with the codes and spheres of its training shapes.
        factor: Lengths are multiplied by it: fits are made for shapes of about 10 units (`factor_of_model`).

    theta is the radius of the sphere around the shape, in the unit of the training's meshes, and the coordinates of
    its code along the principal components of the training's codes, in standard deviations (from -3 to 3, as of a shape
    model): codes that no training shape is near say nothing. Distances are learned, so that intervals are of the
    model's shapes, not of the errors of the network.

    Raises:
        SDMError: The model was trained on one shape: its codes do not vary.
    """

    name = "deepsdf"

    def __init__(self, model: DeepSDF, factor: float = 1.0) -> None:
        self.model, self.device, self.factor = model, model.device, factor
        centred = (model.codes - model.codes.mean(0)).double()
        _, sizes, axes = torch.linalg.svd(centred, full_matrices=False)
        variances = sizes.square() / max(1, len(centred) - 1)
        if not float(variances.sum()) > 0:
            raise SDMError("the DeepSDF was trained on one shape, so its codes do not vary: there is nothing to fit")
        count = int((variances.cumsum(0) < KEPT * variances.sum()).sum()) + 1
        count = min(count, MOST, len(centred) - 1)
        self._mean = model.codes.mean(0).double()
        self._modes = variances[:count, None].sqrt() * axes[:count]
        radii = [sphere.radius for sphere in model.spheres]
        size = Parameter("size", SMALLER * min(radii), LARGER * max(radii))
        self.parameters = (size, *(Parameter(f"code{k + 1}", -LIMIT, LIMIT, "sd") for k in range(count)))
        self.centre = torch.zeros(3, dtype=torch.float64, device=self.device)
        self.slack = SLACK * factor * sorted(radii)[len(radii) // 2]
        self.evaluations = 0
        # A fit gives torch one thread, which is too few for a network.
        self.threads = torch.get_num_threads()
        self._theta: Tensor | None = None

    def code(self, theta: Tensor) -> Tensor:
        """The code (D,) float32 of theta (P,)."""
        return (self._mean + theta[1:].to(self._modes) @ self._modes).float()

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) float64 for theta (P,)."""
        self._count(theta)
        radius = self._radius(theta)
        with torch.no_grad(), threads(self.threads):
            return radius * self.model.signed_distance((points / radius).float(), self.code(theta)).double()

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """The same with their derivatives by theta and point."""
        self._count(theta)
        radius = self._radius(theta)
        with threads(self.threads):
            parts = [self._unit(theta, part) for part in (points / radius).float().split(POINTS)]
        values, by_code, slope = (torch.cat(x) for x in zip(*parts, strict=True))
        # d(r f(x / r)) / dr = f - (x / r) . grad f; the radius is `factor` times the parameter.
        by_size = self.factor * (values - (points / radius * slope).sum(1))
        return Distances(radius * values, torch.cat([by_size[:, None], radius * by_code], 1), slope)

    def surface_mesh(self, theta: Tensor, resolution: int = 128) -> TriangleMesh:
        """The surface for theta (P,) in the frame of the fit, by marching cubes."""
        sphere = UnitSphere((0.0, 0.0, 0.0), self._radius(theta))
        return decode_mesh(self.model, self.code(theta), sphere=sphere, resolution=resolution)

    def _unit(self, theta: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values (N,), derivatives by the code's components (N,K) and by points (N,3), in the unit sphere, float64."""
        code = self.code(theta)
        found = self.model.slopes(points, code)
        with torch.no_grad():
            modes = directions(self._modes.float(), code, self.model.settings.code_bound)
            seen = self.model.decoder.seen(modes, points.clamp(-1, 1).expand(len(modes), -1, -1))
            by_code = torch.zeros(len(points), len(modes), device=points.device)
            for by, part in zip(found.by_seen, seen, strict=True):
                by_code += torch.einsum("ne,kne->nk", by, part.expand(-1, len(points), -1))
        return found.values.double(), by_code.double(), found.by_point.double()

    def _radius(self, theta: Tensor) -> float:
        return self.factor * float(theta[0])

    def _count(self, theta: Tensor) -> None:
        if self._theta is None or not torch.equal(theta, self._theta):
            self._theta = theta.clone()
            self.evaluations += 1


def directions(along: Tensor, code: Tensor, bound: float | None) -> Tensor:
    """Directions (K,D) in which the bounded code moves where a code (D,) moves along (K,D)."""
    length = code.norm()
    if bound is None or float(length) <= bound:
        return along
    outward = code / length
    return (along - (along @ outward)[:, None] * outward) * (bound / length)


def factor_of_model(model: DeepSDF) -> float:
    """The factor by which a model's shapes are of a size that fits are made for; 1 where they are."""
    radii = sorted(sphere.radius for sphere in model.spheres)
    middle = radii[len(radii) // 2]
    return 1.0 if USUAL_RADIUS / 2 <= middle <= 2.5 * USUAL_RADIUS else USUAL_RADIUS / middle
