"""The stream: an iterable dataset of fresh batches that never ends and never repeats."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from functools import partial
from typing import Any

import torch
from torch.utils.data import IterableDataset, get_worker_info

from sdm.core.as_grid import GridLike
from sdm.core.given_values import whole
from sdm.core.grid import Grid
from sdm.engine.arguments import Sign
from sdm.errors import SDMError
from sdm.runtime.prefetch import prefetch
from sdm.shapes import Family
from sdm.stream.batch import Batch
from sdm.stream.drawn_ahead import DrawnAhead
from sdm.stream.ranks import in_process_group, rank_and_size
from sdm.stream.sample_maker import FIRST_DRAWS, FIRST_SIGN, Maker, refuse_fork
from sdm.stream.samplers import Sampler
from sdm.stream.validation_set import ValidationSet

VERSION = 2


class SDMStream(IterableDataset[Batch]):
    """Random shapes and their exact signed distance maps, made on the device, endless and never repeated.

    Args:
        family: The shapes, for example `sdm.shapes.make_family("cochlea")`.
        grid: Where to measure: voxels along each axis of a cube that holds every shape, which is `family.grid(64)`, or
            any grid that `sdm.core.as_grid` takes, for example an image's.
        batch_size: Samples of a batch on each rank.
        seed: Any whole number.
        rank: Number of this process among `world_size`; both by default from torch.distributed or torchrun, asked
            again by each `iter`, so that the process group may be made after the stream.
        world_size: Number of processes that share the stream.
        sampler: "uniform", "sobol", "chebyshev" (denser towards faces and corners), "grid:5" (the tensor grid, again
            and again), "mixture:0.5" (half static, half online), or a `Sampler`.
        device: Where to compute; by default a GPU if there is one.
        dtype: Type of the maps: float32, float16 or bfloat16.
        truncate: Distances beyond this (in the family's unit) become this, with their sign.
        sign: The method by which maps are signed, as for `sdm.signed_distance_map`: for folders of meshes whose faces
            do not say what is inside. A flood takes the meshes of a batch one by one, and waits for the device.
        hole_size: Of a flood, in the family's unit.
        prefetch: How many batches at least are queued on a CUDA stream of their own before they are requested. Small
            ones are made several at once, up to 64 samples, as a GPU takes less time for them so.
        start: Global number of the first sample.
        stop: Global number before which the stream ends, a multiple of the global batch after `start`; None: never.

    Raises:
        DeviceError: The device is not there.
        GridError: A map that does not fit into memory.
        SDMError: A number that makes no sense.

    A sample is a pure function of (seed, global number): the same for any batch size, number of ranks or restart, bit
    for bit on one kind of device. At its n-th step rank r has the numbers
    `start + (n world_size + r) batch_size + (0 ... batch_size - 1)`, so ranks never share one and all together have
    the batch that one process with `world_size` times the batch size has.

    Iterating again goes on where the last batch was given. `state_dict` and `load_state_dict` (as torchdata's
    StatefulDataLoader wants them) do so in another process, with any batch size and number of ranks that lead to
    `stop` in whole steps, both from `start` and from where the state is.

    Batches are fresh tensors, ready for the stream that is current when they are requested, and no step waits for the
    device. Iterate over the stream itself, or a DataLoader with `batch_size=None, num_workers=0`. Workers are for
    the CPU alone, as a forked process cannot use CUDA; they keep the order, and start anew with each `iter` of a
    DataLoader. With `persistent_workers` each goes on after what it had made ahead: batches that a loop left behind are
    lost, and those of the workers may change places.
    """

    def __init__(
        self,
        family: Family,
        grid: GridLike,
        batch_size: int = 16,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        *,
        sampler: Sampler | str = "uniform",
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        truncate: float | None = None,
        sign: Sign = "winding",
        hole_size: float | None = None,
        prefetch: int = 2,
        start: int = 0,
        stop: int | None = None,
    ) -> None:
        super().__init__()
        size, ahead, first = whole(batch_size, 1), whole(prefetch, 1), whole(start, 0)
        last = None if stop is None else whole(stop, 0)
        if size is None:
            raise SDMError(f"the batch size is {batch_size!r}; give a whole number of at least 1")
        if ahead is None:
            raise SDMError(f"prefetch is {prefetch!r}; give at least 1 batch")
        if first is None or (stop is not None and last is None):
            raise SDMError(f"the stream runs from sample {start!r} to {stop!r}; give whole numbers from 0 on")
        self.batch_size, self._prefetched, self._start, self.stop = size, ahead, first, last
        self._find_rank = rank is None and world_size is None
        self._take_rank(rank, world_size)
        self._maker = Maker(
            family,
            grid,
            seed=seed,
            sampler=sampler,
            device=device,
            dtype=dtype,
            truncate=truncate,
            sign=sign,
            hole_size=hole_size,
        )
        self._position = first
        # Whether the position is already that of this worker's own next batch.
        self._own = False
        self._process = os.getpid()

    @property
    def maker(self) -> Maker:
        """Maker of its samples, with all that they depend on: seed, sampler, type, truncation."""
        return self._maker

    @property
    def family(self) -> Family:
        """The shapes."""
        return self._maker.family

    @property
    def grid(self) -> Grid:
        """Grid on which the maps are measured."""
        return self._maker.grid

    @property
    def device(self) -> torch.device:
        """Device on which batches are made, and are."""
        return self._maker.device

    @property
    def global_batch_size(self) -> int:
        """Samples of a step on all ranks together."""
        return self.batch_size * self.world_size

    @property
    def position(self) -> int:
        """Global number of the first sample of the next step: all before it have been given, on all ranks."""
        return self._position

    def __iter__(self) -> Iterator[Batch]:
        worker = get_worker_info()
        self._refuse_fork()
        if self._find_rank and (worker is None or in_process_group()):
            # A spawned worker of a DataLoader is not in the process group; it was given its rank with the stream.
            self._take_rank(None, None)
            self._check_end(self._position)
        workers, first = (1, 0) if worker is None else (worker.num_workers, worker.id)
        # Worker w of a DataLoader makes every n-th step, which is the order in which it asks its n workers.
        stride = workers * self.global_batch_size
        if not self._own and worker is not None:
            self._position += first * self.global_batch_size
            self._own = True
        begin, end = self._position, self.stop
        steps = iter(itertools.count(begin, stride) if end is None else range(begin, end, stride))
        together = max(1, self._maker.at_once // self.batch_size)
        drawn = DrawnAhead(self._maker.draw, self.batch_size, self.rank * self.batch_size, stride, end)
        make = partial(self._make, drawn)
        batches = prefetch(make, steps, self.device, self._prefetched, together)
        return self._count(batches, stride)

    def _take_rank(self, rank: int | None, world_size: int | None) -> None:
        self.rank, self.world_size = rank_and_size(rank, world_size)
        start, stop = self._start, self.stop
        if start < 0 or (stop is not None and (stop < start or (stop - start) % self.global_batch_size)):
            raise SDMError(
                f"the stream runs from sample {start} to {stop}; give a start of at least 0, and a stop that is a "
                f"multiple of the {self.global_batch_size} samples of a global batch after it"
            )

    def _check_end(self, position: int) -> None:
        left = 0 if self.stop is None else self.stop - position
        if left > 0 and left % self.global_batch_size:
            raise SDMError(
                f"the stream goes on from sample {position} to {self.stop}, {left} samples, which is no multiple of "
                f"the {self.global_batch_size} of a global batch; choose another batch size or another stop"
            )

    def _count(self, batches: Iterator[tuple[int, Batch]], stride: int) -> Iterator[Batch]:
        for step, batch in batches:
            # Before the batch is given, so that a state taken by whoever has it says that it is done.
            self._position = step + stride
            yield batch
            del batch

    def _make(self, drawn: DrawnAhead, steps: list[int]) -> list[Batch]:
        return self._maker.make_several(*drawn.take(steps))

    def sample(self, index: int | list[int] | torch.Tensor) -> Batch:
        """The samples with these global numbers, as the stream gives them, whatever its position.

        Raises:
            SDMError: No number, or one below 0.
        """
        numbers = torch.as_tensor(index, dtype=torch.int64, device="cpu").reshape(-1)
        if not len(numbers):
            raise SDMError("no sample was requested; give the number of one, or more")
        if bool((numbers < 0).any()):
            raise SDMError(f"sample {int(numbers.min())} was requested; they are numbered from 0")
        self._refuse_fork()
        return self._maker.make(numbers)

    def validation(self, count: int = 64) -> ValidationSet:
        """A fixed set of uniform samples from the same family, grid and seed that no stream gives."""
        self._refuse_fork()
        return ValidationSet(self._maker, count)

    def state_dict(self) -> dict[str, Any]:
        """State of the stream, ready for JSON or torch.save. Take it after a step: it counts the batches given."""
        return {"version": VERSION, "position": self._position, "own": self._own, "recipe": self._maker.recipe}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state, from the next `iter` on.

        Raises:
            SDMError: The state is of a stream with other samples, or whole batches from there do not end at `stop`.
        """
        if not isinstance(state, dict) or state.get("version") != VERSION:
            raise SDMError("this is not the state of a stream of this version of sdm")
        mine = self._maker.recipe
        for key, value in {"draws": FIRST_DRAWS, **FIRST_SIGN, **state["recipe"]}.items():
            if mine.get(key) != value:
                raise SDMError(
                    f"the state is of a stream whose {key} is {value}, but here it is {mine.get(key)}: "
                    "make the stream as it was"
                )
        position = int(state["position"])
        self._check_end(position)
        self._position, self._own = position, bool(state["own"])

    def _refuse_fork(self) -> None:
        refuse_fork(self.device.type == "cuda" and os.getpid() != self._process)

    def __getstate__(self) -> dict[str, Any]:
        if self._find_rank and in_process_group():
            # For a worker that is spawned: the process group may have been made after the stream.
            self._take_rank(None, None)
        return {k: v for k, v in self.__dict__.items() if k != "_process"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # A process that unpickles a stream was not forked with it.
        self.__dict__.update(state, _process=os.getpid())
