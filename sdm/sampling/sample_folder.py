"""Samples of many meshes, from files to files: reading and writing beside the device's work."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.core.normalization import Normalization
from sdm.engine.arguments import oriented
from sdm.engine.checks.digits_check import look_at_digits
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError, SDMError
from sdm.inspect.quick_look import look_at
from sdm.io import load_mesh
from sdm.runtime.host_copy import HostCopy
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered, one_by_one
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.sampling.law import SURFACE
from sdm.sampling.layouts.instance import Instance
from sdm.sampling.layouts.sample_layout import Layout
from sdm.sampling.recipe import Recipe
from sdm.sampling.sample import PointSamples, draw_points, measure, mesh_seed

# Fewer samples than these may miss the inside of a mesh that has one.
FEW = 10_000


@dataclass(frozen=True)
class SampledMesh:
    """A mesh whose samples are there.

    Args:
        path: The file of its samples, if it has one of its own.
        there: Whether they were there before.
        triangles: Of the mesh, if it was read.
        closed: Whether it has no boundary.
        inside: How many samples are inside.
        unsure: Of a flood, how many have a sign that it does not prove.
        seconds: That it took in all stages.
    """

    path: Path | None = None
    there: bool = False
    triangles: int | None = None
    closed: bool | None = None
    inside: int | None = None
    unsure: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class _Task:
    number: int
    source: Path
    instance: Instance


@dataclass(frozen=True)
class _Read:
    task: _Task
    mesh: TriangleMesh
    normalization: Normalization | None
    closed: bool
    seconds: float


@dataclass(frozen=True)
class _Measured:
    read: _Read
    rows: HostCopy[PointSamples]
    seconds: float


class FolderSampling:
    """Samples of meshes into a folder.

    Args:
        sources: Mesh files.
        instances: Their names in the dataset.
        out: The folder.
        layout: How it is laid out.
        recipe: What is sampled.
        device: Where to compute.
        parts: Part of the folder's split -> numbers of its meshes, for the lists.
        known: Numbers of meshes of which there is nothing to tell if their samples are there; others are read again.
        workers: Threads that read, and as many that write; by default what the machine has.
        times: The pipeline's clock.

    Files do not depend on the number of threads: a sample depends on the seed, the mesh's place in its folder, its own
    number, and the kind of device.
    """

    def __init__(
        self,
        sources: list[Path],
        instances: list[Instance],
        out: Path,
        layout: Layout,
        recipe: Recipe,
        device: torch.device,
        *,
        parts: dict[str, list[int]] | None = None,
        known: frozenset[int] = frozenset(),
        workers: int | None = None,
        times: StageTimes | None = None,
    ) -> None:
        self._parts, self._known = parts or {}, known
        self._tasks = [_Task(n, *pair) for n, pair in enumerate(zip(sources, instances, strict=True))]
        self._layout, self._recipe, self._device = layout, recipe, device
        self.times = StageTimes() if times is None else times
        self._threads = min(threads_beside(device) if workers is None else workers, len(sources))
        self._numbers = torch.arange(recipe.count, dtype=torch.int64, device=device)
        layout.begin(out, instances, recipe.count)

    def run(self) -> Iterator[Done[SampledMesh] | Failed]:
        """Sample all meshes whose samples are not there yet; what became of each, in order."""
        done = [False] * len(self._tasks)
        for number, outcome in self.some(range(len(self._tasks))):
            done[number] = isinstance(outcome, Done)
            yield outcome
        self.end(done)

    def some(self, numbers: Iterable[int]) -> Iterator[tuple[int, Done[SampledMesh] | Failed]]:
        """Sample some of the meshes; the number of each and what became of it, in their order.

        Of those that the layout keeps in one file (`Layout.together`) all are to be among them.
        """
        times, threads = self.times, self._threads
        nbytes = 40 * self._recipe.count
        begun: list[int] = []

        def tasks() -> Iterator[_Task]:
            for number in numbers:
                begun.append(number)
                yield self._tasks[number]

        read = in_threads(
            numbered(tasks()), "read", self._read, workers=threads, times=times, single=len(self._tasks) == 1
        )
        measured = one_by_one(read, str(self._device), self._measure, times=times)
        written = in_threads(
            measured,
            "write",
            self._write,
            workers=threads,
            times=times,
            nbytes=lambda _: nbytes,
            prompt=True,
            single=len(self._tasks) == 1,
        )
        for outcome in written:
            number = begun[outcome.number]
            if isinstance(outcome, Failed):
                self._layout.failed(number)
            yield number, outcome

    def end(self, done: list[bool]) -> None:
        """Complete the folder: whether the samples of each mesh are there."""
        self._layout.end(done, self._parts)

    def _read(self, task: _Task) -> _Read | SampledMesh:
        if self._layout.is_done(task.number):
            return self._there(task)
        start = time.perf_counter()
        mesh = load_mesh(task.source)
        look_at_digits(mesh, str(task.source))
        by = None if self._recipe.normalize is None else Normalization.of(mesh, self._recipe.normalize)
        mesh = mesh if by is None else by.normalised(mesh)
        mesh = oriented(mesh, self._recipe.orient, self._device)
        closed = look_at(mesh).is_closed(mesh)
        if self._recipe.sign != "winding":
            return _Read(task, mesh, by, closed, time.perf_counter() - start)
        if not closed and self._recipe.open_meshes == "reject":
            raise MeshError(
                f"{task.source} is not closed, so its inside is not defined: --sign flood closes it, --open-meshes "
                "keep goes by its winding number"
            )
        if doubts := look_at(mesh).problems(mesh):
            raise MeshError(f"{task.source}: {doubts[0]}")
        return _Read(task, mesh, by, closed, time.perf_counter() - start)

    def _there(self, task: _Task) -> SampledMesh:
        """A mesh whose samples are there."""
        if task.number not in self._known:
            # The file may have gone since.
            with contextlib.suppress(SDMError):
                mesh = oriented(load_mesh(task.source), self._recipe.orient, self._device)
                return SampledMesh(there=True, triangles=len(mesh), closed=look_at(mesh).is_closed(mesh))
        return SampledMesh(there=True)

    def _measure(self, read: _Read | SampledMesh) -> _Measured | SampledMesh:
        if isinstance(read, SampledMesh):
            return read
        start, recipe = time.perf_counter(), self._recipe
        index = MeshIndex(read.mesh, self._device, warn=False)
        seed = mesh_seed(recipe.seed, read.task.instance.path)
        points, normals = draw_points(index.mesh, recipe.law, seed, self._numbers)
        kinds = recipe.law.kinds(self._numbers)
        closest = recipe.closest or self._layout.with_normals
        found = measure(
            index,
            self._layout.rounded(points),
            kinds,
            normals,
            read.normalization,
            sign=recipe.sign,
            hole_size=recipe.hole_size,
            closest=closest,
        )
        parts = [found.points, found.distances[:, None]]
        parts += [part for part in (found.closest, found.normals) if part is not None]
        make = partial(_samples_of, kinds=kinds, normalization=read.normalization, unsure=found.unsure)
        rows = HostCopy(torch.cat(parts, 1), make)
        return _Measured(read, rows, read.seconds + time.perf_counter() - start)

    def _write(self, found: _Measured | SampledMesh) -> SampledMesh:
        if isinstance(found, SampledMesh):
            return found
        start, read = time.perf_counter(), found.read
        samples = found.rows.wait()
        inside = int(samples.occupancies.sum())
        spread = int((samples.kinds != SURFACE).sum())
        if self._recipe.sign != "none" and inside == 0 and spread:
            flood = self._recipe.sign == "flood"
            few = ", or too little for so few (--count)" if spread < FEW else ""
            gaps = ", or has gaps, which a larger hole_size closes (--hole-size)" if flood else ""
            raise MeshError(
                f"none of {spread:,} samples around {read.task.source} is inside: it encloses nothing{few}{gaps}"
            )
        path = self._layout.write(read.task.number, samples)
        seconds = found.seconds + time.perf_counter() - start
        return SampledMesh(path, False, len(read.mesh), read.closed, inside, samples.unsure, seconds)


def _samples_of(rows: Tensor, kinds: Tensor, normalization: Normalization | None, unsure: int) -> PointSamples:
    whole = rows.shape[1] > 4
    more = (rows[:, 4:7], rows[:, 7:10]) if whole else (None, None)
    return PointSamples(rows[:, :3], rows[:, 3], kinds.cpu(), normalization, *more, unsure)
