"""Account of the meshes of `sdm compute`, as they are done: what is printed, kept in the manifest and reported."""

from __future__ import annotations

from collections.abc import Iterable

from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.map_manifest import MapManifest
from sdm.cli.maps.map_told import Told, line_of_old
from sdm.cli.maps.mesh_report import MeshEntry
from sdm.cli.maps.work import MapTask


class MapAccount:
    """Account of all meshes in their order; of those that the manifest knows it tells by itself.

    Args:
        tasks: All meshes.
        manifest: Of the folder.
        progress: Where lines go.
    """

    def __init__(self, tasks: list[MapTask], manifest: MapManifest, progress: FileProgress) -> None:
        self._tasks, self._manifest, self._progress = tasks, manifest, progress
        found = ((number, manifest.find(task)) for number, task in enumerate(tasks))
        self._old = {number: entry for number, entry in found if entry is not None}
        self.entries: list[MeshEntry] = []
        progress.begin(tasks[0].name)

    @property
    def wanted(self) -> list[int]:
        """Numbers of the meshes that are to be done."""
        return [number for number in range(len(self._tasks)) if number not in self._old]

    def hear(self, several: Iterable[Told]) -> None:
        """Take what is told of meshes that are wanted, in their order."""
        for told in several:
            self._tell_old(told.number)
            if told.entry.state != "failed":
                self._manifest.add(self._tasks[told.number], told.entry)
            self._add(told.entry, told.lines, told.warnings)

    def end(self) -> list[MeshEntry]:
        """Entries of all meshes."""
        self._tell_old(len(self._tasks))
        return self.entries

    def _tell_old(self, before: int) -> None:
        while (number := len(self.entries)) < before:
            self._add(self._old[number], [line_of_old(self._tasks[number])], [])

    def _add(self, entry: MeshEntry, lines: list[str], warnings: list[str]) -> None:
        self.entries.append(entry)
        for line in lines:
            self._progress.print(line)
        for line in warnings:
            self._progress.print(line, warn=True)
        self._progress.end()
        if len(self.entries) < len(self._tasks):
            self._progress.begin(self._tasks[len(self.entries)].name)
