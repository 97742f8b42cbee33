"""Free-form remainder of a fit: each vertex moves along its normal, as smoothly as the image allows.

A shape model of a few dozen shapes does not hold a new one to a voxel, however well it is fitted. From its surface on,
vertices x = x0 + D minimise

    |image - expected image|^2 / noise^2 + sum_v |D_v - mean of its neighbours' D|^2 / roughness^2

with the partial volume of `Renderer` by exact distances. The derivative of a sample point's distance by the vertices is
that of its closest point: minus the barycentric coordinates of the closest triangle. Steps are Gauss-Newton's by
conjugate gradients, under a logistic that is wide at first, so that a surface that lies some voxels off is felt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMError
from sdm.fit.model.backend import Distances
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.solve.fit_shape import image_tensor
from sdm.training.conjugate_gradients import conjugate_gradients

# Lengths of the logistic, in voxels, steps at each, and steps of conjugate gradients for one of these.
LENGTHS, STEPS, SOLVES = (1.6, 0.8, 0.4, 0.2), 4, 40
# No vertex moves further than this in a step [voxels].
FURTHEST = 2.0
# Voxels with less of the other side than this tell the noise.
PURE = 0.01


@dataclass(frozen=True, eq=False)
class FreeForm:
    """A surface after its free-form remainder.

    Args:
        mesh: In the image's frame and unit.
        moved: Root mean square of how far its vertices moved.
        noise: Standard deviation of the noise, in intensities.
        inside: Intensity inside.
        outside: Intensity outside.
    """

    mesh: TriangleMesh
    moved: float
    noise: float
    inside: float
    outside: float


def free_form(
    image: Tensor,
    grid: GridLike,
    mesh: TriangleMesh,
    *,
    blur: float,
    roughness: float | None = None,
    device: torch.device | str | None = None,
    report: Callable[[str, int], None] | None = None,
) -> FreeForm:
    """Refine a surface to an image, free of any family.

    Args:
        image: (nx,ny,nz) intensities: one inside and one outside, mixed in the voxels that the surface cuts, and noise.
        grid: Where its voxels are.
        mesh: A closed surface within a few voxels, in the grid's frame and unit; its triangles should be even.
        blur: Standard deviation of the scanner's point spread function, in the grid's unit.
        roughness: How far a vertex moves from where its neighbours do, a standard deviation in the grid's unit; by
            default a tenth of the mean edge.
        device: Where to compute; by default a GPU if there is one.
        report: Called with "free form" and the number of each step, of 16.

    Raises:
        GridError: The image does not fit its grid.
        SDMError: A blur below 0 or a roughness that is not positive.
    """
    if blur < 0 or (roughness is not None and not roughness > 0):
        raise SDMError(f"blur is {blur}, roughness {roughness}; 0 or more and a positive number are needed")
    grid, where = as_grid(grid), choose_device(device)
    values = image_tensor(image, grid, where)
    surface = _Surface(mesh, where)
    edge = float(surface.edge_lengths().mean())
    smooth = 1 / (edge / 10 if roughness is None else roughness) ** 2
    voxel = min(grid.spacing)
    noise, levels = 0.0, (0.0, 0.0)
    for number, length in enumerate(LENGTHS):
        renderer = Renderer(grid, surface, blur=blur, length=length * voxel, fine=max(grid.spacing))
        for step in range(STEPS):
            noise, levels = _step(surface, renderer, values, smooth, FURTHEST * voxel)
            if report is not None:
                report("free form", number * STEPS + step + 1)
    moved = float((surface.vertices - surface.rest).square().sum(1).mean().sqrt())
    found = TriangleMesh(surface.vertices.float(), surface.faces, mesh.name, check=False)
    return FreeForm(found, moved, noise, *levels)


def _step(
    surface: _Surface, renderer: Renderer, values: Tensor, smooth: float, furthest: float
) -> tuple[float, tuple[float, float]]:
    """One Gauss-Newton step of all vertices; the noise and the intensities inside and outside before it."""
    near, inside = renderer.near_surface(surface.state)
    hit = surface.closest(renderer.points_of(near))
    share, place = inside.double(), tuple(near.T)
    share[place] = p = torch.sigmoid(-hit.values / renderer.length)
    # By each corner of the closest triangle as it moves along its normal.
    by_corner = (p * (1 - p) / renderer.length)[:, None] * hit.weights
    corners = hit.corners.reshape(-1)
    voxels = renderer.blurred(share)
    low, high = _levels(values, voxels)
    residual = values - (low + (high - low) * voxels)
    pure = (voxels < PURE) | (voxels > 1 - PURE)
    noise = float(residual[pure].std()) if int(pure.sum()) > 100 else float(residual.std())
    contrast, weight = high - low, 1 / max(noise, 1e-3 * abs(high - low)) ** 2

    def forward(amount: Tensor) -> Tensor:
        at = torch.zeros_like(share)
        at[place] = (by_corner * amount[hit.corners]).sum(1)
        return contrast * renderer.blurred(at)

    def backward(image: Tensor) -> Tensor:
        at = renderer.spread(image)[place]
        return torch.zeros(len(surface.rest), dtype=torch.float64, device=image.device).index_add(
            0, corners, (contrast * by_corner * at[:, None]).reshape(-1)
        )

    normals = surface.normals()
    moved = surface.vertices - surface.rest

    def bent(displacement: Tensor) -> Tensor:
        return smooth * (normals * surface.transposed(surface.rough(displacement))).sum(1)

    def normal_equations(amount: Tensor) -> Tensor:
        along = amount[:, None] * normals
        return weight * backward(forward(amount)) + bent(along) + 1e-6 * smooth * amount

    amount = conjugate_gradients(normal_equations, weight * backward(residual) - bent(moved), SOLVES)
    surface.move(amount.clamp(-furthest, furthest)[:, None] * normals)
    return noise, (high, low)


def _levels(values: Tensor, share: Tensor) -> tuple[float, float]:
    """Intensities outside and inside, by least squares."""
    design = torch.stack([1 - share.flatten(), share.flatten()], 1)
    low, high = torch.linalg.solve(design.T @ design, design.T @ values.flatten()).tolist()
    return low, high


@dataclass(frozen=True, eq=False)
class _Closest:
    """Signed distances (N,), the corners (N,3) of the closest triangles, and by how much each moves the surface."""

    values: Tensor
    corners: Tensor
    weights: Tensor


class _Surface:
    """A mesh whose vertices move, as a backend without parameters that lies as it is in the image."""

    name, parameters, slack, evaluations = "mesh", (), 1e-4, 0

    def __init__(self, mesh: TriangleMesh, device: torch.device) -> None:
        self.device = device
        self.rest = self.vertices = mesh.vertices.detach().to(device, torch.float64)
        self.faces = mesh.faces.to(device)
        self.centre = torch.zeros(3, dtype=torch.float64, device=device)
        eye = torch.eye(3, dtype=torch.float64, device=device)
        self.state = State(self.centre[:0], eye, self.centre, self.centre)
        long = self.faces.long()
        pairs = torch.cat([long[:, [0, 1]], long[:, [1, 2]], long[:, [2, 0]]]).sort(1).values
        self._a, self._b = torch.unique(pairs, dim=0).unbind(1)
        ones = torch.ones(len(self._a), dtype=torch.float64, device=device)
        count = torch.zeros(len(self.rest), dtype=torch.float64, device=device)
        self._degree = count.index_add(0, self._a, ones).index_add(0, self._b, ones).clamp_min(1)[:, None]
        self._index = MeshIndex(TriangleMesh(self.rest.float(), self.faces, check=False), device)

    def move(self, by: Tensor) -> None:
        """Move vertices by (V,3)."""
        self.vertices = self.vertices + by
        self._index.update(self.vertices.float())

    def edge_lengths(self) -> Tensor:
        """(E,) lengths of the edges."""
        return (self.vertices[self._a] - self.vertices[self._b]).norm(dim=1)

    def normals(self) -> Tensor:
        """(V,3) outward unit normals of vertices, by the area of the faces around."""
        a, b, c = self.vertices[self.faces.long()].unbind(1)
        face = torch.linalg.cross(b - a, c - a)
        total = torch.zeros_like(self.vertices).index_add(0, self.faces.long().T.reshape(-1), face.repeat(3, 1))
        return torch.nn.functional.normalize(total, dim=1)

    def rough(self, moved: Tensor) -> Tensor:
        """(V,3) displacements less the mean of the neighbours'."""
        around = torch.zeros_like(moved).index_add(0, self._a, moved[self._b]).index_add(0, self._b, moved[self._a])
        return moved - around / self._degree

    def transposed(self, moved: Tensor) -> Tensor:
        """The transpose of `rough`."""
        own = moved / self._degree
        return moved - torch.zeros_like(moved).index_add(0, self._a, own[self._b]).index_add(0, self._b, own[self._a])

    def closest(self, points: Tensor) -> _Closest:
        """Of points (N,3): what their distances are and which vertices they hang on."""
        values, hit = self._index.signed_distance(points.float(), return_closest=True)
        away = (points - hit.points.double()) * torch.where(values < 0, -1.0, 1.0)[:, None]
        corners = self.faces[hit.faces.long()].long()
        a, b, c = self.vertices[corners].unbind(1)
        face = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
        length = away.norm(dim=1, keepdim=True)
        direction = torch.where(length > 1e-5, away / length.clamp_min(1e-30), face)
        facing = torch.einsum("nkc,nc->nk", self.normals()[corners], direction)
        return _Closest(values.double(), corners, hit.barycentric.double() * facing)

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3)."""
        return self._index.signed_distance(points.float()).double()

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """There are no parameters to differentiate by: see `closest`."""
        raise NotImplementedError
