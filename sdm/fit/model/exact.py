"""The exact backend: the mesh engine's signed distances, and their derivatives without finite differences.

With y the closest point on the surface and n the outward direction from it, d SDM(x) / d theta = -n . dy / d theta:
y slides along the surface to first order, so only the motion of the point of the mesh that y is now counts. That point
is w1 v1 + w2 v2 + w3 v3 on its triangle, so its motion is that of the corners, weighted.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.engine.points import PointsIndex
from sdm.errors import SDMError
from sdm.fit.model.backend import Distances
from sdm.fit.model.jacobian import vertices_of, vertices_with_jacobian
from sdm.shapes import Family, make_family

# Nearer to the surface than this [mm], the direction is that of the face: a difference of equal numbers has none.
ON_SURFACE = 1e-5
# With 5,000, chords of the sections leave biases of half a posterior standard deviation at 0.2 mm; with 20,000, 0.2.
TRIANGLES = 20_000
# The search for a start sees voxels of 0.6 mm, for which a tenth is enough, and most shapes of a fit are built there.
ROUGH_TRIANGLES = 2_000


class ExactBackend:
    """Exact distances to the meshes of a family.

    Args:
        family: Its `reference_vertices` must be known to torch's forward-mode differentiation; by default the cochlea
            with 20,000 triangles.
        device: Where to compute; by default a GPU if there is one.

    The closest triangles are found in float32; the distances to them and their derivatives are float64.
    """

    name = "exact"
    slack = 1e-4

    def __init__(self, family: Family | None = None, device: str | torch.device | None = None) -> None:
        self.device = choose_device(device)
        if not isinstance(family, Family | None):
            raise SDMError(f"{family!r} is no family of shapes: sdm.shapes.load_family makes one of a name")
        self.family = make_family("cochlea", TRIANGLES) if family is None else family
        self.parameters = self.family.parameters
        self.faces = self.family.faces_on(self.device)
        self.evaluations = 0
        self._finer: ExactBackend | None = None
        self._theta = torch.full((len(self.parameters),), torch.nan, dtype=torch.float64, device=self.device)
        self._jacobian: Tensor | None = None
        low, high = self._box()
        self.centre = (low + high) / 2

    def rough(self) -> ExactBackend | None:
        """The same family from coarser meshes, for coarse images; None where there is nothing to save."""
        family = self.family.with_triangles(ROUGH_TRIANGLES)
        if family is None or self.faces.shape[0] <= 2 * ROUGH_TRIANGLES:
            return None
        rough = type(self)(family, self.device)
        rough.name, rough.centre = f"{self.name}, rough", self.centre
        return rough

    def finer(self) -> ExactBackend | None:
        """The same family from meshes of four times as many triangles; None where that is no matter of choice."""
        if self._finer is None:
            family = self.family.with_triangles(4 * self.faces.shape[0])
            if family is None:
                return None
            self._finer = ExactBackend(family, self.device)
            self._finer.name, self._finer.centre = f"{self.name}, finer", self.centre
        return self._finer

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) float64 for theta (P,)."""
        self._move_to(theta)
        return self._index.signed_distance(points.float()).double()

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """Signed distances with their derivatives by theta and point, all float64."""
        jacobian = self.surface(theta)[1]
        values, closest = self._index.signed_distance(points.float(), return_closest=True)
        weights = closest.barycentric.double()
        weights = weights / weights.sum(1, keepdim=True)
        corners = self.faces[closest.faces].long()
        triangles = self._vertices[corners]
        foot = torch.einsum("nk,nkc->nc", weights, triangles)
        away = points - foot
        length = away.norm(dim=1)
        sign = torch.where(values < 0, -1.0, 1.0).double()
        normal = torch.linalg.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normal = torch.nn.functional.normalize(normal, dim=1)
        direction = away * (sign / length.clamp_min(1e-30))[:, None]
        direction = torch.where((length < ON_SURFACE)[:, None], normal, direction)
        by_theta = -torch.einsum("nk,nc,nkcp->np", weights, direction, jacobian[corners])
        return Distances(sign * length, by_theta, direction)

    def surface(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Vertices (V,3) [mm] and their derivatives (V,3,P) by theta, float64."""
        self._move_to(theta)
        if self._jacobian is None:
            self._jacobian = vertices_with_jacobian(self.family, self._theta)[1]
        return self._vertices, self._jacobian

    def _move_to(self, theta: Tensor) -> None:
        theta = theta.detach().to(self.device, torch.float64)
        if torch.equal(theta, self._theta):
            return
        self._vertices, self._jacobian = vertices_of(self.family, theta), None
        mesh = TriangleMesh(self._vertices.float(), self.faces, self.family.name, check=False)
        self._index = self._indexed(mesh)
        self._theta = theta.clone()
        self.evaluations += 1

    def _indexed(self, mesh: TriangleMesh) -> PointsIndex:
        """Index of a mesh, asked for distances and for the closest points."""
        return PointsIndex(mesh, self.device)

    def _box(self) -> tuple[Tensor, Tensor]:
        middle = torch.tensor([(p.low + p.high) / 2 for p in self.parameters], dtype=torch.float64, device=self.device)
        vertices = vertices_of(self.family, middle)
        return vertices.min(0).values, vertices.max(0).values
