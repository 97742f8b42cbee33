"""Sample maker, from global numbers to a batch: the one way in which streams and datasets make samples."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, SupportsIndex

import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.device import choose_device, require_memory
from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.arguments import Sign, SignMethod
from sdm.engine.checks.caller_warning import named
from sdm.engine.checks.values_check import ValuesCheck
from sdm.engine.maps import batch_maps
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import DeviceError, MeshError, SDMError
from sdm.io.maps.half_precision import diagonal_of, require_half_range
from sdm.runtime.torch_warp import to_device
from sdm.shapes import Family
from sdm.shapes.named_family import check_promises
from sdm.stream.batch import Batch
from sdm.stream.known_boundaries import Topology
from sdm.stream.samplers import Sampler, as_sampler

# Samples that are made at once where there is a choice: so many that a GPU is busy, of so many bytes of maps and
# triangles at most.
MOST_AT_ONCE, BYTES_AT_ONCE, TRIANGLES_AT_ONCE = 64, 1 << 27, 1 << 21

# Version of the random numbers that a seed stands for. Recipes without one are of version 1, in which seeds were not
# hashed with their purpose (`sdm.core.random.derive_seed`).
DRAWS, FIRST_DRAWS = 2, 1

# Recipes of before say nothing about signs.
FIRST_SIGN = {"sign": "winding", "hole_size": None}

DTYPES = {torch.float32: "float32", torch.float16: "float16", torch.bfloat16: "bfloat16"}


class Maker:
    """Makes samples: each a pure function of (seed, global number), bit for bit on one kind of device.

    Args:
        family: The shapes.
        grid: Where to measure.
        seed: Any whole number.
        sampler: Which parameters, by name or as a `Sampler`.
        device: Where to compute; by default a GPU if there is one.
        dtype: Type of the maps: float32, float16 or bfloat16.
        truncate: Distances beyond this (in the family's unit) become this, with their sign; None keeps all.
        sign: The method by which maps are signed, as for `sdm.signed_distance_map`. A flood goes from mesh to mesh and
            waits for the device.
        hole_size: Of a flood.

    Raises:
        DeviceError: The device is not there.
        GridError: A map that does not fit into memory.
        MeshError: No family, or one of yours whose parts do not fit together.
        SDMError: A seed, a type or a truncation that makes no sense, or distances that float16 may not hold.

    A family of your own keeps the promise if the vertices of a sample do not depend on the batch around it, which is
    so for all arithmetic by element, but not for every matrix product.
    """

    def __init__(
        self,
        family: Family,
        grid: GridLike,
        *,
        seed: int = 0,
        sampler: Sampler | str = "uniform",
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        truncate: float | None = None,
        sign: Sign = "winding",
        hole_size: float | None = None,
    ) -> None:
        if not isinstance(family, Family):
            raise MeshError(f"{family!r:.80} is no family of shapes: sdm.shapes.load_family makes one of a name")
        check_options(seed=seed, sampler=sampler, dtype=dtype, truncate=truncate, sign=sign, hole_size=hole_size)
        self.signs = SignMethod(sign, hole_size)
        grid = family.grid(grid) if isinstance(grid, int) else as_grid(grid)
        if dtype == torch.float16:
            require_half_range(grid, diagonal_of(grid), truncate, "or truncate to less")
        if device is None or str(device).startswith("cuda"):
            refuse_fork(getattr(torch.cuda, "_is_in_bad_fork", bool)())
        self.family, self.grid, self.seed = family, grid, operator.index(seed)
        self.sampler = as_sampler(sampler)
        self.device = choose_device(device)
        if not type(family).__module__.startswith("sdm."):
            check_promises(family, type(family).__name__, self.device)
        self.dtype, self.truncate = dtype, None if truncate is None else float(truncate)
        require_memory(grid.nbytes, self.device, f"a map of {' x '.join(map(str, grid.shape))} voxels")
        self.sampler.size(family)
        self._prepare()

    def _prepare(self) -> None:
        with torch.inference_mode(False), torch.no_grad():
            self._topology = Topology(self.family, self.device)
        self._check = ValuesCheck()

    def __getstate__(self) -> dict[str, Any]:
        # What is known about a family's faces is known about its tensors in this process.
        return {key: value for key, value in self.__dict__.items() if key not in ("_topology", "_check")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()

    @property
    def recipe(self) -> dict[str, Any]:
        """All that a sample depends on besides its number, ready for JSON."""
        return {
            "family": self.family.name,
            "fingerprint": self.family.fingerprint,
            "grid": grid_record(self.grid),
            "seed": self.seed,
            "sampler": str(self.sampler),
            "draws": DRAWS,
            "dtype": DTYPES[self.dtype],
            "truncate": self.truncate,
            "sign": self.signs.sign,
            "hole_size": self.signs.hole_size,
        }

    @property
    def at_once(self) -> int:
        """Number of samples to make in one call, where there is a choice."""
        triangles = self.family.triangles_per_sample
        return max(1, min(MOST_AT_ONCE, BYTES_AT_ONCE // self.grid.nbytes, TRIANGLES_AT_ONCE // triangles))

    def theta(self, index: Tensor) -> Tensor:
        """Parameters (B,P) float32 on the host for global numbers (B,) int64 on the host."""
        return self.sampler.theta(self.family, self.seed, index)

    def draw(self, index: Tensor) -> Tensor:
        """`theta`, whatever the caller has turned on."""
        with self._as_ever():
            return self.theta(index)

    def make(self, index: Tensor, drawn: Tensor | None = None) -> Batch:
        """The samples with these global numbers (B,) int64 on the host: fresh tensors, queued on the current stream.

        `drawn` is their `theta`, where that is known. Never waits for the device. What the caller has turned on
        (autocast, gradients, inference mode) changes nothing.
        """
        with self._as_ever():
            host = self.theta(index) if drawn is None else drawn
            theta = to_device(host, self.device)
            return Batch(theta, self._maps(theta, host), index)

    def make_several(self, index: Tensor, drawn: Tensor | None = None) -> list[Batch]:
        """A batch for each row of `index` (S,B), as `make` gives them, by one call, which a GPU takes less time for.

        `drawn` (S,B,P) is their `theta`. Each batch's maps are memory of their own, so that one of them can be kept
        without the others; the parameters, a few kilobytes, are not.
        """
        whole = self.make(index.reshape(-1), None if drawn is None else drawn.flatten(0, 1))
        count, size = index.shape
        if count == 1:
            return [whole]
        with self._as_ever():
            parts = list(whole.sdm.split(size))
            maps = [torch.empty_like(part) for part in parts]
            # One launch instead of one for each.
            torch._foreach_copy_(maps, parts)  # pyright: ignore[reportPrivateImportUsage]
            return [Batch(whole.theta[at * size : (at + 1) * size], maps[at], index[at]) for at in range(count)]

    @contextmanager
    def _as_ever(self) -> Iterator[None]:
        """Context in which nothing that the caller has turned on counts."""
        with ExitStack() as stack:
            stack.enter_context(torch.inference_mode(False))
            stack.enter_context(torch.no_grad())
            stack.enter_context(torch.autocast(self.device.type, enabled=False))
            if self.device.type == "cuda":
                stack.enter_context(torch.cuda.device(self.device))
            yield

    def measure(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """Maps (B,1,nx,ny,nz) of vertices (B,V,3) on the device, in the type that was requested."""
        if self.signs.sign == "flood":
            values = torch.stack([self._flooded(each, faces) for each in vertices])
        else:
            values = batch_maps(vertices.contiguous(), faces, self.grid, self._topology.edges(vertices, faces))
            values = values.abs_() if self.signs.sign == "none" else values
        if self._check.found is not None:
            self._check.end()
        elif self._check.grid is None:
            with named(f"{self.family.name}: "):
                self._check.look_at_maps(vertices, faces, self.grid, values, self.signs.sign)
        if self.truncate is not None:
            values = values.clamp_(-self.truncate, self.truncate)
        return values.to(self.dtype)[:, None]

    def _flooded(self, vertices: Tensor, faces: Tensor) -> Tensor:
        index = MeshIndex(TriangleMesh(vertices, faces, check=False), self.device, warn=False)
        return index.signed_distance_map(self.grid, sign="flood", hole_size=self.signs.hole_size).values

    def _maps(self, theta: Tensor, host: Tensor) -> Tensor:
        if type(self.family).groups is Family.groups:
            return self.measure(self.family.vertices(theta), self.family.faces_on(self.device))
        values = torch.empty((theta.shape[0], 1, *self.grid.shape), dtype=self.dtype, device=self.device)
        for group in self.family.groups(theta, host):
            values.index_copy_(0, group.rows, self.measure(group.vertices, group.faces))
        return values


def check_options(
    *,
    seed: int = 0,
    sampler: Sampler | str = "uniform",
    dtype: torch.dtype = torch.float32,
    truncate: float | None = None,
    sign: Sign = "winding",
    hole_size: float | None = None,
) -> None:
    """Refuse options of a `Maker` that make no sense whatever the family and the grid, before a shape is made.

    Raises:
        SDMError: A seed, a sampler, a type, a truncation or a sign that there is not.
    """
    SignMethod(sign, hole_size)
    if not isinstance(seed, SupportsIndex):
        raise SDMError(f"the seed is {seed!r}; give a whole number")
    if not isinstance(dtype, torch.dtype) or dtype not in DTYPES:
        raise SDMError(f"maps of type {dtype} are not supported; use float32, float16 or bfloat16")
    if truncate is not None and not 0 < real(truncate) < math.inf:
        raise SDMError(f"the truncation {truncate!r} must be a positive distance")
    as_sampler(sampler)


def refuse_fork(forked: bool) -> None:
    """Say what to do in a forked process, where CUDA cannot be used.

    Raises:
        DeviceError: It is one.
    """
    if forked:
        raise DeviceError(
            "a forked process cannot use CUDA: iterate over the stream itself, or give the DataLoader num_workers=0 "
            "(batches are made ahead on the GPU, so workers gain nothing)"
        )


def grid_record(grid: Grid) -> dict[str, Any]:
    """A grid ready for JSON, which keeps every digit: `Grid(**record)` makes it again."""
    lists = {key: list(getattr(grid, key)) for key in ("origin", "spacing", "shape")}
    return {**lists, "direction": [list(row) for row in grid.direction]}
