"""The stages of `sdm compute`: reading and writing in threads, measuring in the caller's."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.maps.map_readers import MapReaders
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_sharing import LARGEST_BESIDE
from sdm.cli.maps.map_writers import MapWriters
from sdm.cli.maps.remarks import remarks
from sdm.cli.maps.work import MapTask, Measured, ReadMesh, Written
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.arguments import oriented
from sdm.engine.checks.caller_warning import quiet
from sdm.engine.many import signed_distance_maps
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMError
from sdm.inspect.quick_look import look_at
from sdm.io import check_target, grid_like, write_streamed
from sdm.io.bands.save_and_load import check_band_target, save_band
from sdm.io.files.stand_in import fetched
from sdm.io.maps.formats import check_target_name, format_of, require_memory_to_write
from sdm.io.maps.record import digest_of
from sdm.io.maps.save_and_load import made_from, write_made_from
from sdm.runtime.host_copy import HostCopy


class MapStages:
    """The work on each mesh, stage by stage.

    Args:
        settings: What is the same for all.
        progress: Called with the share of a large map that is done, while it is written.
        alone: Whether there is one mesh only.
        writers: Processes that write maps; by default threads do.
        readers: Of meshes; by default threads.
    """

    def __init__(
        self,
        settings: Settings,
        progress: Callable[[float], Any],
        *,
        alone: bool = False,
        writers: MapWriters | None = None,
        readers: MapReaders | None = None,
    ) -> None:
        self._settings, self._alone, self._writers = settings, alone, writers
        self._readers = MapReaders(None, settings.how) if readers is None else readers
        self._progress = progress
        # Folders that have taken a file: trying it once for each map would be six calls of the system.
        self._writable: set[Path] = set()

    def read(self, task: MapTask) -> ReadMesh:
        """Read and place a mesh, and see whether its map is there already."""
        start, settings = time.perf_counter(), self._settings
        self._check_target(task.target)
        loaded, known = self._readers.read(task.source)
        mesh, by = settings.placed(loaded)
        grid = settings.grid(mesh, known.box if known is not None and mesh is loaded else None)
        settings.check_range(mesh, grid)
        measured = oriented(mesh, settings.orient, settings.device)
        if measured is not loaded:
            known = None
        digest = digest_of(measured, settings.how) if known is None else known.digest
        there = settings.resume and _finished(task, grid, digest)
        if not there and settings.like_image is not None:
            refuse_inputs([task.target], [settings.like_image])
        closed = known is not None and known.paired
        return ReadMesh(task, mesh, measured, by, grid, digest, there, time.perf_counter() - start, closed)

    def _check_target(self, target: Path) -> None:
        if self._settings.band is not None:
            check_band_target(target)
        elif target.parent in self._writable:
            check_target_name(target)
        else:
            check_target(target)
            self._writable.add(target.parent)

    def measure(self, group: Sequence[ReadMesh]) -> list[Measured]:
        """The maps of some meshes, by one call where that is possible."""
        start, settings = time.perf_counter(), self._settings
        wanted = [read for read in group if not read.there]
        joint = len(wanted) > 1 and not any(map(self._is_by_itself, wanted))
        made: list[Measured] = []
        if joint:
            for read in wanted:
                require_memory_to_write(format_of(read.task.target), read.grid, settings.device)
            with quiet():
                maps = signed_distance_maps(
                    [read.measured for read in wanted],
                    [read.grid for read in wanted],
                    device=settings.device,
                    sign=settings.sign,
                    hole_size=settings.hole_size,
                )
            made = [self._on_the_way(read, found) for read, found in zip(wanted, maps, strict=True)]
        else:
            made = [self._measure_one(read) for read in wanted]
        each = (time.perf_counter() - start) / max(1, len(wanted))
        by_number = iter(made)
        return [
            Measured(read, None, None, 0, read.seconds) if read.there else _later(next(by_number), each)
            for read in group
        ]

    def _measure_one(self, read: ReadMesh) -> Measured:
        settings = self._settings
        chosen = format_of(read.task.target)
        index = MeshIndex(read.measured, settings.device, warn=False)
        if settings.band is not None:
            band = index.narrow_band(
                read.grid, half_width=settings.band, sign=settings.sign, hole_size=settings.hole_size
            )
            save_band(band, read.task.target, read.digest)
            self._progress(1.0)
            return Measured(read, None, band.inside_voxels, band.ambiguous_voxels or 0, read.seconds)
        signs: dict[str, Any] = {"sign": settings.sign, "hole_size": settings.hole_size}
        require_memory_to_write(chosen, read.grid, settings.device)
        if not (self._is_by_itself(read) and chosen.streamed):
            asked = {} if settings.sign == "winding" else signs
            found = self._on_the_way(read, index.signed_distance_map(read.grid, **asked))
            if not self._is_by_itself(read):
                return found
            # By itself: two of these may not fit into memory.
            inside, ambiguous = self._save(found)
            self._progress(1.0)
            return Measured(read, None, inside, ambiguous, read.seconds)
        counts = write_streamed(
            index,
            read.grid,
            read.task.target,
            progress=self._progress,
            made_from=read.digest,
            stored=settings.stored,
            truncated=settings.truncate,
            normalization=read.normalization,
            **signs,
        )
        return Measured(read, None, counts.inside, counts.ambiguous, read.seconds)

    def _is_by_itself(self, read: ReadMesh) -> bool:
        return self._alone or self._settings.band is not None or read.grid.nbytes > LARGEST_BESIDE

    def _on_the_way(self, read: ReadMesh, field: SDM) -> Measured:
        """A map on its way to the host, cut and of its type."""
        values = self._settings.stored(field.values)
        make = partial(
            _map_of,
            grid=field.grid,
            ambiguous_voxels=field.ambiguous_voxels,
            sign=field.sign,
            hole_size=field.hole_size,
            truncated=self._settings.truncate,
            normalization=read.normalization,
        )
        copy = HostCopy(values, make) if self._writers is None else self._writers.host_copy(values, make)
        return Measured(read, copy, None, field.ambiguous_voxels or 0, read.seconds)

    def write(self, found: Measured) -> Written:
        """Write a map, and look at it."""
        start = time.perf_counter()
        closed = found.read.closed or look_at(found.read.measured).is_closed(found.read.measured)
        if found.read.there:
            return Written(found.read, closed)
        inside, ambiguous = self._save(found)
        warnings = remarks(found.read, closed, inside, ambiguous, self._settings.sign)
        seconds = found.seconds + time.perf_counter() - start
        return Written(found.read, closed, inside, ambiguous, seconds, warnings)

    def _save(self, found: Measured) -> tuple[int, int]:
        if found.map is None:
            return found.inside or 0, found.ambiguous
        try:
            field = found.map.wait()
            workers = None if self._writers is None else self._writers.workers
            inside = write_made_from(field, found.read.task.target, found.read.digest, workers=workers)
            return field.inside_voxels if inside is None else inside, found.ambiguous
        finally:
            # Of one that failed too, or whoever measures the next would wait for it.
            if self._writers is not None:
                self._writers.free(found.map)


def _map_of(values: Tensor, **kept: Any) -> SDM:
    return SDM(values, **kept)


def _later(found: Measured, seconds: float) -> Measured:
    return Measured(found.read, found.map, found.inside, found.ambiguous, found.seconds + seconds)


def _finished(task: MapTask, grid: Grid, digest: str) -> bool:
    """True if a file is a map, on this grid, of the mesh with this digest."""
    try:
        with fetched(task.target):
            return grid_like(task.target) == grid and made_from(task.target) == digest
    except SDMError:
        return False
