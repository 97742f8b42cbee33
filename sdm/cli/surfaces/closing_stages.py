"""The stages of `sdm watertight`: reading and writing in threads, closing in the caller's."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from sdm.cli.surfaces.journal import Journal
from sdm.core.mesh import TriangleMesh
from sdm.engine.surface import Method
from sdm.inspect.quick_look import look_at
from sdm.io import load_mesh
from sdm.io.maps.record import digest_of
from sdm.io.meshes.write import save_mesh
from sdm.remeshing import WatertightReport, watertight
from sdm.remeshing.watertight import Hidden, check_options
from sdm.runtime.host_copy import HostCopy

# Bytes of vertices or faces above which they are not copied through pinned memory, which stays the process's.
MOST_PINNED = 1 << 28


@dataclass(frozen=True)
class Closing:
    """Options that are the same for all meshes, see `sdm.watertight`."""

    resolution: int
    offset: float | None
    hole_size: float | None
    hidden: Hidden
    method: Method
    device: str

    def __post_init__(self) -> None:
        check_options(self.resolution, self.offset, self.hole_size, self.hidden, self.method)

    @property
    def how(self) -> str:
        """All that a surface depends on besides the mesh."""
        return f" {self.resolution} {self.offset} {self.hole_size} {self.hidden} {self.method}"


@dataclass(frozen=True)
class ReadSurface:
    """A mesh that was read: its digest, what is known of a surface that is there already, and the seconds it took."""

    target: Path
    mesh: TriangleMesh
    digest: str
    known: dict[str, Any] | None
    seconds: float


@dataclass(frozen=True)
class Closed:
    """A mesh with its surface and the report about them; neither if it is there already.

    Args:
        read: The mesh.
        surface: Vertices and faces on their way to the host.
        nbytes: Their memory.
        report: About both.
        seconds: That all took.
    """

    read: ReadSurface
    surface: tuple[HostCopy[Tensor], HostCopy[Tensor]] | None
    nbytes: int
    report: WatertightReport | None
    seconds: float


class ClosingStages:
    """The work on each mesh, stage by stage."""

    def __init__(self, options: Closing, journal: Journal) -> None:
        self._options, self._journal = options, journal

    def read(self, job: tuple[Path, Path]) -> ReadSurface:
        """Read a mesh, and see whether its surface is there already."""
        start = time.perf_counter()
        source, target = job
        mesh = load_mesh(source)
        digest = digest_of(mesh, self._options.how)
        known = self._journal.find(target, digest)
        if known is None:
            # What the next stage asks first, by this thread: that stage is the one that others wait for.
            look_at(mesh).closes_plainly(mesh)
        return ReadSurface(target, mesh, digest, known, time.perf_counter() - start)

    def close(self, read: ReadSurface) -> Closed:
        """Make the surface of a mesh."""
        if read.known is not None:
            return Closed(read, None, 0, None, read.seconds)
        start, options = time.perf_counter(), self._options
        surface, report = watertight(
            read.mesh,
            options.resolution,
            options.offset,
            options.hole_size,
            hidden=options.hidden,
            method=options.method,
            device=options.device,
            return_report=True,
        )
        parts = surface.vertices, surface.faces
        copies = _to_host(parts[0]), _to_host(parts[1])
        nbytes = parts[0].nbytes + parts[1].nbytes
        return Closed(read, copies, nbytes, report, read.seconds + time.perf_counter() - start)

    def write(self, found: Closed) -> Closed:
        """Write a surface."""
        if found.surface is None:
            return found
        start = time.perf_counter()
        vertices, faces = (copy.wait() for copy in found.surface)
        save_mesh(TriangleMesh(vertices, faces, found.read.mesh.name, check=False), found.read.target)
        # What was written is let go.
        return Closed(found.read, None, 0, found.report, found.seconds + time.perf_counter() - start)


def _to_host(values: Tensor) -> HostCopy[Tensor]:
    """Vertices or faces on their way to the host: beside what the device does next, unless there are very many."""
    return HostCopy(values if values.nbytes <= MOST_PINNED else values.cpu(), lambda on_host: on_host)
