"""Shape family: a box of parameters, and vertices on fixed faces for every point of the box."""

from __future__ import annotations

import hashlib
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.given_values import real, whole
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.random import derive_seed
from sdm.errors import MeshError
from sdm.shapes import sampling

# Shapes that decide how large a family's grid must be, besides the corners of its box.
PROBES = 512
MOST_CORNERS = 256


@dataclass(frozen=True)
class Parameter:
    """One parameter of a family.

    Args:
        name: Its name.
        low: Least value.
        high: Greatest value; the same as `low` for a parameter that is fixed.
        unit: Unit, for example "mm" or "rad"; "1" for a plain number.
    """

    name: str
    low: float
    high: float
    unit: str = "1"

    def __post_init__(self) -> None:
        if not -math.inf < real(self.low) <= real(self.high) < math.inf:
            raise MeshError(f"{self.name} runs from {self.low!r} to {self.high!r}; give finite ends, the lower first")
        for end, value in (("low", self.low), ("high", self.high)):
            # Numbers of NumPy's and torch's look different in a fingerprint, and a manifest does not take them.
            if type(value) is not int:
                object.__setattr__(self, end, float(value))


@dataclass(frozen=True, eq=False)
class Group:
    """Samples of a batch that share faces: `vertices[i]` (V,3) belongs to sample `rows[i]` of the batch."""

    rows: Tensor
    vertices: Tensor
    faces: Tensor


class Family(ABC):
    """A family of meshes: parameters theta to vertices, faces fixed.

    A subclass sets `parameters` and `triangles` and defines `vertices`. The faces are (F,3) int32,
    counter-clockwise seen from outside; they close the surface for every theta in the box.
    """

    parameters: tuple[Parameter, ...]
    triangles: Tensor
    name: ClassVar[str] = "shape"
    # True if samples are meshes of a user's, read from a folder, whose own coordinates a dataset keeps the way back to:
    # see `sample_transforms`.
    places_meshes: ClassVar[bool] = False
    # True if its name is not enough to make it: it is read from files.
    needs_files: ClassVar[bool] = False
    # Name and reason of each file that was not used.
    rejected: tuple[tuple[str, str], ...] = ()
    _tables: Sequence[Tensor] = ()

    @abstractmethod
    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) float32 for theta (B,P) float32, on theta's device, differentiable in theta.

        Values are not checked (that would wait for a GPU): see `check`.
        """

    @property
    def faces(self) -> Tensor:
        """The faces (F,3) int32, on the host."""
        return self.faces_on("cpu")

    def faces_on(self, device: torch.device | str) -> Tensor:
        """The faces (F,3) int32 on a device: the same tensor each time, so that what is known about it lasts."""
        return self._on(device, "triangles", lambda: [self.triangles])[0]

    def mesh(self, theta: Any) -> TriangleMesh:
        """The mesh of one theta (P,), on its device.

        Raises:
            MeshError: theta is outside the box, not finite, or not one sample.
        """
        theta = self.check(theta)
        if theta.shape[0] != 1:
            raise MeshError(f"theta holds {theta.shape[0]} samples; mesh() takes one: use vertices() for a batch")
        return TriangleMesh(self.vertices(theta)[0], self.faces_on(theta.device), self.name, check=False)

    def groups(self, theta: Tensor, host: Tensor | None = None) -> Iterator[Group]:
        """The batch in groups that share faces, with no triangle more than each sample needs: here one group.

        Args:
            theta: (B,P) float32.
            host: The same on the host, so that a family whose faces differ need not wait for the device.
        """
        rows = torch.arange(theta.shape[0], device=theta.device)
        yield Group(rows, self.vertices(theta), self.faces_on(theta.device))

    @property
    def triangles_per_sample(self) -> int:
        """Triangles that a sample costs by `groups`, on average."""
        return max(1, len(self.triangles))

    def probes(self, theta: Tensor) -> list[Tensor]:
        """theta (B,P) with what chooses the faces set, once for each set of faces that `groups` gives: here once."""
        return [theta]

    def reference_vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) for theta (B,P) by code that torch's forward-mode differentiation knows.

        A family whose `vertices` is an operator gives its plain torch twin here, in theta's own type; of any other,
        they are `vertices`.
        """
        return self.vertices(theta)

    def with_triangles(self, triangles: int) -> Family | None:
        """The same shapes from meshes of about so many triangles; None where that is no matter of choice."""
        return None

    def sample_transforms(self, theta: Tensor) -> Tensor | None:
        """Matrices (B,4,4) float64 from a mesh's own coordinates to those of its sample, for theta (B,P) on the host.

        None for families whose shapes have no coordinates of their own: those that do not set `places_meshes`.
        """
        return None

    @classmethod
    def example(cls) -> Family:
        """A small family of this class, for tests and quick looks."""
        make: Any = cls
        return make(triangles=600)

    def check(self, theta: Any) -> Tensor:
        """theta as float32 (B,P), after a look at every value (on a GPU this waits for the device).

        Raises:
            MeshError: One sentence: the wrong width, a value that is not finite, or one outside the box.
        """
        tensor = theta if isinstance(theta, Tensor) else as_tensor(theta, torch.float32, "the values of theta")
        tensor = as_theta(tensor[None] if tensor.ndim == 1 else tensor, len(self.parameters), self.name)
        values = tensor.detach().cpu()
        for column, p in enumerate(self.parameters):
            # The ends as float32, so that a bound that float32 cannot hold does not refuse itself.
            low, high = torch.tensor([p.low, p.high], dtype=torch.float32, device="cpu")
            wrong = ~((values[:, column] >= low) & (values[:, column] <= high))
            if bool(wrong.any()):
                row = int(wrong.nonzero()[0])
                value = float(values[row, column])
                where = f"theta[{row}]" if len(values) > 1 else "theta"
                raise MeshError(
                    f"{p.name} of {where} is {value:g}; {self.name} takes {p.low:g} to {p.high:g}"
                    + ("" if p.unit == "1" else f" {p.unit}")
                )
        return tensor

    def from_unit(self, unit: Tensor) -> Tensor:
        """theta (B,P) for points (B,P) of the unit cube."""
        low, width = self._on(unit.device, "box", self._box)
        return torch.addcmul(low, unit, width)

    def to_unit(self, theta: Tensor) -> Tensor:
        """Points (B,P) of the unit cube for theta (B,P)."""
        low, width = self._on(theta.device, "box", self._box)
        return torch.where(width > 0, (theta - low) / width.clamp_min(1e-30), 0)

    def sample(
        self,
        count: int,
        *,
        seed: int = 0,
        start: int = 0,
        sampler: str = "uniform",
        device: torch.device | str | None = None,
    ) -> Tensor:
        """theta (count,P) of the samples number `start` to `start + count - 1`.

        Args:
            count: How many.
            seed: Any whole number.
            start: Number of the first.
            sampler: As for `sample_at`.
            device: Of the result; by default a GPU if there is one.

        Raises:
            MeshError: A count or a start below 0, or another sampler.
        """
        if whole(count, 0) is None or whole(start, 0) is None:
            raise MeshError(f"{count!r} samples from number {start!r} were requested; both are at least 0")
        where = choose_device(device)
        index = torch.arange(start, start + count, dtype=torch.int64, device=where)
        return self.sample_at(index, seed=seed, sampler=sampler)

    def sample_at(self, index: Tensor | Sequence[int], *, seed: int = 0, sampler: str = "uniform") -> Tensor:
        """theta (B,P) of the samples with these global numbers.

        Args:
            index: (B,) int64, 0 or more; the result is on its device.
            seed: Any whole number.
            sampler: "uniform", "sobol" or "chebyshev".

        A sample depends on (family's name, sampler, seed, number) alone, however the numbers are split into batches.
        """
        numbers = sampling.as_index(index)
        sampling.check_sampler(sampler)
        own = derive_seed(seed, "samples of a family", self.name, sampler)
        return self.from_unit(sampling.draw(sampler, own, numbers, len(self.parameters)))

    def grid_samples(self, per_axis: int, *, device: torch.device | str | None = None) -> Tensor:
        """theta (per_axis^P, P) of the tensor grid over the box, its faces included: 625 for 5 and 4 parameters.

        On `device`, by default a GPU if there is one.

        Raises:
            MeshError: Fewer than 2 points for each axis, or too many in all.
        """
        unit = sampling.grid(per_axis, len(self.parameters))
        return self.from_unit(unit.to(choose_device(device)))

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest x, y, z (3,) over the box of parameters: over its corners and 512 Sobol points.

        A family whose extremes lie elsewhere says here how far it reaches.
        """
        width = len(self.parameters)
        unit = sampling.sobol(0, torch.arange(PROBES, device="cpu"), width)
        if 2**width <= MOST_CORNERS:
            corners = torch.tensor(list(itertools.product((0.0, 1.0), repeat=width)), dtype=torch.float32, device="cpu")
            unit = torch.cat([unit, corners])
        lows, highs = [], []
        with torch.no_grad():
            for part in unit.split(16):
                points = self.vertices(self.from_unit(part))
                lows.append(points.amin((0, 1)))
                highs.append(points.amax((0, 1)))
        return torch.stack(lows).amin(0), torch.stack(highs).amax(0)

    def grid(self, resolution: int = 64, *, margin: float = 0.05) -> Grid:
        """A cube of voxels that holds every shape of the family.

        Args:
            resolution: Voxels along each axis.
            margin: Room on each side, as a share of the longest edge of the box around all shapes.

        Raises:
            GridError: Another resolution than a number of voxels, or a margin below 0.
        """
        check_resolution(resolution, margin)
        low, high = self.bounds()
        corners = torch.stack([low, high, low])
        box = TriangleMesh(corners, torch.tensor([[0, 1, 2]], device="cpu"), self.name)
        return Grid.around(box, resolution=resolution, margin=margin)

    @property
    def fingerprint(self) -> str:
        """Hash of what the family is: its name, parameters, faces and constants. Equal on every machine."""
        digest = hashlib.sha256(repr((type(self).__qualname__, self.name, self.parameters)).encode())
        for tensor in (self.triangles, *self._tables):
            digest.update(repr((str(tensor.dtype), tuple(tensor.shape))).encode())
            digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()

    def _box(self) -> list[Tensor]:
        low = torch.tensor([p.low for p in self.parameters], dtype=torch.float32, device="cpu")
        high = torch.tensor([p.high for p in self.parameters], dtype=torch.float32, device="cpu")
        return [low, high - low]

    def _on(self, device: torch.device | str, key: str, make: Callable[[], Sequence[Tensor]]) -> list[Tensor]:
        """Cached tensors of `make` on a device: made and copied there once, then kept under `key`."""
        where = torch.device(device)
        if where.type == "cuda" and where.index is None:
            where = torch.device("cuda", torch.cuda.current_device())
        # Made on first use, so that a subclass need not call a constructor here.
        copies: dict[tuple[torch.device, str], list[Tensor]] = vars(self).setdefault("_copies", {})
        if (where, key) not in copies:
            # What is made in inference mode could never be saved for a gradient.
            with torch.inference_mode(False):
                copies[where, key] = [t.to(where, copy=t.is_inference()) for t in make()]
        return copies[where, key]

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key != "_copies"}

    def __repr__(self) -> str:
        names = ", ".join(f"{p.name} {p.low:g}..{p.high:g} {p.unit}" for p in self.parameters)
        return f"{type(self).__name__}({names}; {self.triangles.shape[0]} triangles)"


def check_resolution(resolution: int | Sequence[int], margin: float = 0.05) -> Grid:
    """Refuse what is no resolution or margin around any shape, before one is made; the grid around one of edge 1.

    Raises:
        GridError: As of `Grid.around`.
    """
    return Grid.around_box(np.zeros(3), np.ones(3), resolution, margin=margin, name="a shape")


def as_theta(theta: Tensor, width: int, name: str) -> Tensor:
    """theta as float32 (B,width).

    Raises:
        MeshError: Another shape.
    """
    if not isinstance(theta, Tensor):
        raise MeshError(f"theta is {type(theta).__name__}; {name} needs a tensor (B, {width})")
    if theta.ndim != 2 or theta.shape[1] != width:
        raise MeshError(f"theta has shape {tuple(theta.shape)}; {name} needs (B, {width})")
    return theta.to(torch.float32)
