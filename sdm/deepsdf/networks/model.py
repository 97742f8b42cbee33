"""A trained DeepSDF: codes to signed distances, without a mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.device import choose_device
from sdm.core.given_values import as_path
from sdm.core.mesh import as_tensor
from sdm.deepsdf.networks.auto_decoder import AutoDecoder, bounded
from sdm.deepsdf.networks.decoders import Decoder
from sdm.deepsdf.samples import UnitSphere
from sdm.deepsdf.train import checkpoint
from sdm.deepsdf.train.settings import Settings
from sdm.errors import SDMError
from sdm.training.checkpoints import fitting_states

# Points that are decoded at a time where no gradient is requested.
CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class Slopes:
    """Signed distances with derivatives, in unit-sphere radii.

    Args:
        values: (N,).
        by_point: (N,3).
        by_seen: (N,E) by each part of what the point sees of the code (`seen` of the decoders).
    """

    values: Tensor
    by_point: Tensor
    by_seen: tuple[Tensor, ...]


class DeepSDF:
    """A decoder and the codes of the shapes it was trained on.

    Args:
        settings: What it is.
        decoder: From codes (B,D) and points (B,N,3) of the unit sphere's box to signed distances (B,N).
        codes: (S,D) of the training shapes.
        names: The shapes' names.
        spheres: Their normalisations.

    Codes are (D,) tensors with D = `code_size`. A code says nothing of place and size: `sphere` does, and without it
    points and distances are in the unit sphere.
    """

    def __init__(
        self,
        settings: Settings,
        decoder: Decoder,
        codes: Tensor,
        names: Sequence[str],
        spheres: Sequence[UnitSphere],
    ) -> None:
        self.settings = settings
        self.decoder = decoder.eval().requires_grad_(False)
        self.codes = codes.detach()
        self.names = tuple(names)
        self.spheres = tuple(spheres)
        # Trained with a clamped loss, values beyond this only say that a point is further.
        self.reach = settings.clamp if settings.variant == "published" else math.inf

    @classmethod
    def load(cls, path: str | Path, device: str | torch.device | None = None) -> DeepSDF:
        """Read a model that `sdm train deepsdf` wrote, or, by the name "cochlea", the one that comes with the package.

        Raises:
            FormatError: The file is not there, is something else, is damaged, or is of another version.
        """
        where = choose_device(device)
        saved = checkpoint.read_model(as_path(path), where)
        settings = Settings.of_record(saved["settings"], path)
        with fitting_states(as_path(path), checkpoint.DAMAGED):
            whole = AutoDecoder(settings, len(saved["names"])).to(where)
            whole.load_state_dict(saved["state"])
        spheres = [UnitSphere((x, y, z), radius) for x, y, z, radius in saved["spheres"]]
        return cls(settings, whole.decoder, whole.bounded_codes(), saved["names"], spheres)

    @property
    def device(self) -> torch.device:
        """Device of the network."""
        return self.codes.device

    @property
    def code_size(self) -> int:
        """Numbers of a code."""
        return self.settings.code_size

    def signed_distance(self, points: Any, code: Any, sphere: UnitSphere | None = None) -> Tensor:
        """Signed distances of points from the shape that a code says, as `sdm.signed_distance` gives them of a mesh.

        Args:
            points: (...,3) in the sphere's unit, NumPy or torch.
            code: (D,).
            sphere: Where the shape is; the unit sphere if not given.

        Returns:
            (...) float32 on the model's device, negative inside, in the sphere's unit; differentiable in points and
            code. Learned, not exact; a model of the "published" variant only knows distances up to `reach`.
            Beyond the box around the sphere: the value at the box's nearest point plus the distance from there.

        Raises:
            SDMError: A code of the wrong size, or a point or code that is not finite.
        """
        at = self.check_points(points)
        z = self.check_codes(code)
        if z.shape[0] != 1:
            raise SDMError(f"{z.shape[0]} codes were given; signed_distance takes one")
        unit = at if sphere is None else (at - at.new_tensor(sphere.centre)) / sphere.radius
        flat = unit.reshape(1, -1, 3)
        if torch.is_grad_enabled() and (flat.requires_grad or z.requires_grad):
            values = self._extended(z, flat)
        else:
            values = torch.cat([self._extended(z, part) for part in flat.split(CHUNK, 1)], 1)
        return values.reshape(at.shape[:-1]) * (1.0 if sphere is None else sphere.radius)

    def normals(self, points: Any, code: Any, sphere: UnitSphere | None = None) -> Tensor:
        """Unit outward normals (...,3) at points (...,3) of the surface, by back-propagation through the network.

        `code` and `sphere` are those of `signed_distance`.
        """
        with torch.enable_grad():
            at = self.check_points(points).detach().requires_grad_()
            values = self.signed_distance(at, self.check_codes(code).detach(), sphere)
            (slope,) = torch.autograd.grad(values.sum(), at)
        return normalize(slope, dim=-1, eps=1e-20)

    def slopes(self, points: Tensor, code: Tensor) -> Slopes:
        """Signed distances of points (N,3) of the unit sphere with their derivatives; values as `signed_distance`."""
        with torch.enable_grad():
            at = points.detach()[None].requires_grad_()
            inside, away = _parts(at)
            seen = self.decoder.seen(self.check_codes(code), inside)
            more = [at.new_zeros(1, at.shape[1], part.shape[2], requires_grad=True) for part in seen]
            values = self.decoder.decode(tuple(s + m for s, m in zip(seen, more, strict=True)), inside) + away
            by_point, *by_seen = torch.autograd.grad(values.sum(), [at, *more])
        return Slopes(values[0].detach(), by_point[0], tuple(part[0] for part in by_seen))

    def signed_distance_map(self, grid: GridLike, code: Any, sphere: UnitSphere | None = None) -> Any:
        """The learned map of a whole grid, an `SDM`, negative inside, in the sphere's unit.

        `code` and `sphere` are those of `signed_distance`.
        """
        from sdm.core.signed_distance_map import SDM

        grid = as_grid(grid)
        layers = max(1, CHUNK // (grid.shape[1] * grid.shape[2]))
        with torch.no_grad():
            parts = [
                self.signed_distance(grid.points(begin, min(begin + layers, grid.shape[0])), code, sphere)
                for begin in range(0, grid.shape[0], layers)
            ]
        return SDM(torch.cat(parts), grid)

    def check_points(self, points: Any) -> Tensor:
        """Points (...,3) float32 on the model's device, every one finite."""
        at = as_tensor(points, torch.float32, "the points", device=self.device)
        if at.ndim == 0 or at.shape[-1] != 3:
            raise SDMError(f"the points have shape {tuple(at.shape)}; (..., 3) is needed")
        if not bool(at.isfinite().all()):
            bad = int((~at.isfinite().all(-1)).sum())
            raise SDMError(f"{bad} of the points are not finite; leave them out")
        return at

    def check_codes(self, codes: Any) -> Tensor:
        """Codes (B,D) float32 on the model's device, every number finite, no longer than the bound."""
        z = as_tensor(codes, torch.float32, "the code", device=self.device)
        z = z[None] if z.ndim == 1 else z
        if z.ndim != 2 or z.shape[1] != self.code_size:
            raise SDMError(
                f"the code has {z.shape[-1] if z.ndim else 0} numbers; this model's codes have {self.code_size}"
            )
        if not bool(z.isfinite().all()):
            raise SDMError("the code holds a number that is not finite; make it again with sdm encode")
        return bounded(z, self.settings.code_bound)

    def _extended(self, codes: Tensor, points: Tensor) -> Tensor:
        inside, away = _parts(points)
        return self.decoder(codes, inside) + away


def _parts(points: Tensor) -> tuple[Tensor, Tensor]:
    """The box's nearest points (...,3), and how far away from them (...) points are."""
    inside = points.clamp(-1, 1)
    beyond = points - inside
    # The gradient of a norm at zero is not a number.
    out = beyond.abs().amax(-1) > 0
    away = torch.where(out[..., None], beyond, 1.0).norm(dim=-1)
    return inside, torch.where(out, away, 0.0)
