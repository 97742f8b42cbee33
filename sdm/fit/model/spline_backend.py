"""A backend from a model of whole maps: a surrogate, its derivatives by forward mode, cubic B-splines between voxels.

Linear interpolation would not do: between voxels 0.2 mm apart it is off by up to 0.01 mm where the surface is curved,
as much as the posterior is wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.grid import Grid
from sdm.errors import SDMError
from sdm.fit.model.backend import Backend, Distances
from sdm.fit.model.jacobian import with_jacobian
from sdm.fit.solve.initial import middle_of
from sdm.runtime.threads import threads
from sdm.shapes import Parameter, families

# How far a surrogate may be off near the surface before the search for the surface's band misses some of it [mm].
SLACK = 0.1
# Voxels of a model's grid, of which its errors are taken to be the same. Those of trained networks hang together over
# two; with ten, intervals hold what nine fits through a coarse network are off (bench/results/fit-cases-paper.json).
PATCH = 10


class GridBackend:
    """Distances from maps on a fixed grid in the shape's own frame.

    Args:
        model: From theta (B,P) float32 to maps (B,1,nx,ny,nz) [mm], negative inside; plain torch, on `device`.
        grid: The maps' grid, or an image or map that has it, which holds every shape and half a millimetre around.
        parameters: The ranges of theta; the cochlea's by default.
        device: Where the model is.
        name: What to call it in reports.
        slack: How far values may be from true distances near the surface [mm].
        rough: A model of the same maps on a coarser grid, for coarse images.
        exact: The backend that the maps stand for, of the same parameters and frame: `fit_shape` asks it twice, near
            the end, to take the maps' error out. Without one it does not.
        error: How far the maps are off near the surface, root mean square [mm], by the model's card or record. A fit
            that ends on the maps alone has it in its intervals; without it such a fit is not trusted.

    Values and derivatives in space and in theta belong to one and the same smooth function.
    """

    def __init__(
        self,
        model: Callable[[Tensor], Tensor],
        grid: GridLike,
        parameters: tuple[Parameter, ...] | None = None,
        *,
        device: str | torch.device = "cpu",
        name: str = "surrogate",
        slack: float = SLACK,
        rough: tuple[Callable[[Tensor], Tensor], Grid] | None = None,
        exact: Backend | None = None,
        error: float | None = None,
    ) -> None:
        self.model, self.grid, self.name, self.slack = model, as_grid(grid), name, slack
        self.parameters = families["cochlea"].parameters if parameters is None else parameters
        self.device = torch.device(device)
        self.evaluations = 0
        if exact is not None and tuple(exact.parameters) != tuple(self.parameters):
            raise SDMError(f"the exact backend of {name} has other parameters than the maps: give both the same")
        if error is not None and not 0 <= error < math.inf:
            raise SDMError(f"the error of {name} is {error}; give its root mean square near the surface, 0 or more")
        self._rough, self.exact, self.error = rough, exact, error
        self.patch = PATCH * max(self.grid.spacing)
        # The model is work for all threads, whatever the fit around it uses.
        self._threads = torch.get_num_threads()
        self.centre = self._centre()
        self._to_coefficients = [_spline_matrix(n).to(self.device) for n in self.grid.shape]
        self._theta: Tensor | None = None
        self._stack: Tensor | None = None

    def rough(self) -> GridBackend | None:
        """The coarser model, if there is one."""
        if self._rough is None:
            return None
        rough = GridBackend(*self._rough, self.parameters, device=self.device, name=f"{self.name}, rough")
        rough.centre, rough.slack = self.centre, 2 * self.slack
        return rough

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) float64 for theta (P,)."""
        self._move_to(theta, derivatives=False)
        assert self._stack is not None  # noqa: S101 - for the type checker
        at, beyond = self._places(points)
        return _interpolate(self._stack[..., :1].contiguous(), at)[0][:, 0] + beyond

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """Signed distances with their derivatives by theta and point, all float64."""
        self._move_to(theta, derivatives=True)
        assert self._stack is not None  # noqa: S101 - for the type checker
        at, beyond = self._places(points)
        values, slopes = _interpolate(self._stack, at, slopes=True)
        assert slopes is not None  # noqa: S101 - for the type checker
        spacing = torch.tensor(self.grid.spacing, dtype=torch.float64, device=self.device)
        return Distances(values[:, 0] + beyond, values[:, 1:], slopes / spacing)

    def _move_to(self, theta: Tensor, *, derivatives: bool) -> None:
        theta = theta.detach().to(self.device, torch.float64)
        same = self._theta is not None and self._stack is not None and torch.equal(theta, self._theta)
        if same and (not derivatives or self._stack.shape[-1] > 1):  # type: ignore[union-attr]
            return
        self.evaluations += not same
        maps = self.maps(theta, derivatives)
        for axis, matrix in enumerate(self._to_coefficients):
            maps = (maps.movedim(axis + 1, -1) @ matrix.T.to(maps.dtype)).movedim(-1, axis + 1)
        # What belongs to one place lies together: the interpolation waits for memory.
        self._stack, self._theta = maps.movedim(0, -1).contiguous(), theta.clone()

    def maps(self, theta: Tensor, derivatives: bool) -> Tensor:
        """The map for theta (P,), and its derivatives by each parameter: (1 or 1+P,nx,ny,nz)."""
        with torch.no_grad(), threads(self._threads):
            if not derivatives:
                return self.model(theta.float()[None])[0]
            values, by_theta = with_jacobian(lambda t: self.model(t[None])[0, 0], theta.float())
            return torch.cat([values[None], by_theta.movedim(-1, 0)])

    def _places(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Voxel coordinates (N,3), pulled into the grid, and how far outside it they were [mm]."""
        origin = torch.tensor(self.grid.origin, dtype=torch.float64, device=self.device)
        spacing = torch.tensor(self.grid.spacing, dtype=torch.float64, device=self.device)
        last = torch.tensor(self.grid.shape, dtype=torch.float64, device=self.device) - 1
        at = (points - origin) / spacing
        inside = torch.minimum(at.clamp_min(0), last)
        return inside, ((at - inside) * spacing).norm(dim=1)

    def _centre(self) -> Tensor:
        if tuple(self.parameters) == families["cochlea"].parameters:
            from sdm.fit.model.exact import ExactBackend

            # The same point as the exact backend's, so that the two agree on what a pose is.
            return ExactBackend(device="cpu").centre.to(self.device)
        return middle_of(self.grid).to(self.device)


def _spline_matrix(count: int) -> Tensor:
    """From values at the voxels to coefficients of the cubic B-spline through them, (count + 2, count) float64.

    One coefficient more on each side; the third derivative is continuous next to the ends ("not a knot").
    """
    system = torch.zeros(count + 2, count + 2, dtype=torch.float64)
    rows = torch.arange(count)
    for offset, weight in enumerate((1 / 6, 4 / 6, 1 / 6)):
        system[rows + 1, rows + offset] = weight
    jump = torch.tensor([1.0, -4.0, 6.0, -4.0, 1.0], dtype=torch.float64)
    system[0, :5], system[-1, -5:] = jump, jump
    return torch.linalg.inv(system)[:, 1:-1].contiguous()


def _interpolate(stack: Tensor, at: Tensor, *, slopes: bool = False) -> tuple[Tensor, Tensor | None]:
    """The splines (nx+2,ny+2,nz+2,C) at voxel coordinates (N,3): values (N,C), and slopes (N,3) of the first."""
    nx, ny, nz, channels = stack.shape
    limit = torch.tensor((nx, ny, nz), device=at.device) - 4
    base = torch.minimum(at.floor().long(), limit)
    weights, by_place = _basis(at - base)
    values = torch.zeros(len(at), channels, dtype=torch.float64, device=at.device)
    slope = torch.zeros(len(at), 3, dtype=torch.float64, device=at.device)
    strides = (ny * nz, nz, 1)
    first = (base * torch.tensor(strides, device=at.device)).sum(1)
    # Row n is the four coefficients of every channel from place n on, as they lie in memory.
    rows = stack.as_strided((nx * ny * nz - 3, 4 * channels), (channels, 1))
    x, y, z = weights.unbind(1)
    by_x, by_y, by_z = by_place.unbind(1)
    for i in range(4):
        for j in range(4):
            taken = rows[first + (i * strides[0] + j * strides[1])].double().view(-1, 4, channels)
            along = torch.einsum("nkc,nk->nc", taken, z)
            values += along * (x[:, i] * y[:, j])[:, None]
            if slopes:
                slope[:, 0] += along[:, 0] * (by_x[:, i] * y[:, j])
                slope[:, 1] += along[:, 0] * (x[:, i] * by_y[:, j])
                slope[:, 2] += (taken[:, :, 0] * by_z).sum(1) * (x[:, i] * y[:, j])
    return values, slope if slopes else None


def _basis(t: Tensor) -> tuple[Tensor, Tensor]:
    """The four cubic B-splines at t in [0,1], and their slopes: (...,4) each."""
    s = 1 - t
    values = torch.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3], -1) / 6
    slopes = torch.stack([-(s**2), 3 * t**2 - 4 * t, -3 * s**2 + 4 * s, t**2], -1) / 2
    return values, slopes
