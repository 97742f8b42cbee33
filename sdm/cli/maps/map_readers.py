"""Processes that read meshes beside the one that measures them: each has a Python lock of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.map_writers import processes_pay
from sdm.cli.maps.work import MapTask
from sdm.core.mesh import LARGEST_COORDINATE, TriangleMesh
from sdm.io import load_mesh
from sdm.io.files.stand_in import known
from sdm.io.meshes.arrays.binary_files import READERS, BinaryMesh
from sdm.runtime.pipeline.thread_count import readers_beside
from sdm.runtime.worker_processes.pool import WorkerProcesses

# What these processes run.
READ = "sdm.io.meshes.arrays.binary_files:read_binary"


class MapReaders:
    """Meshes of files, read by processes where these can.

    Args:
        workers: Processes that run `READ`; None where this one reads all.
        how: Of the meshes' digests.
    """

    def __init__(self, workers: WorkerProcesses | None, how: str) -> None:
        self._workers, self._how = workers, how

    def read(self, path: Path) -> tuple[TriangleMesh, BinaryMesh | None]:
        """A mesh, and what is known of it if another process read it.

        Raises:
            MeshError: See `load_mesh`.
            WorkerError: That process died.
        """
        found: BinaryMesh | None = None
        if self._workers is not None and path.suffix.lower() in READERS:
            found = self._workers.call(path, self._how)
        if found is None:
            return load_mesh(path), None
        check = found.largest > LARGEST_COORDINATE
        return TriangleMesh(found.vertices, found.faces, path.name, check=check), found


def reading_processes(settings: Settings, tasks: Sequence[MapTask]) -> int:
    """Number of processes that are to read these meshes; 0 where threads do it.

    Args:
        settings: Of all maps.
        tasks: The meshes.
    """
    # At an address, meshes are fetched by this process.
    if not processes_pay(settings, tasks) or known():
        return 0
    binary = sum(task.source.suffix.lower() in READERS for task in tasks)
    return readers_beside(settings.device) if 2 * binary > len(tasks) else 0
