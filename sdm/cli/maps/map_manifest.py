"""Manifest of a folder of maps that is being made: a line of JSON for each mesh that is done.

So a restart reads no mesh again that was done, and the report at the end tells of it what it told then. A line holds
for the same settings, and as long as neither the mesh's file nor the map's was touched since; of any other mesh
`--resume` looks at both files' contents. At an address the times are the server's, and the manifest is brought there
now and then.
"""

from __future__ import annotations

import contextlib
from dataclasses import fields, replace
from pathlib import Path
from stat import S_ISREG
from types import TracebackType
from typing import Any, Self

import torch

from sdm.cli.maps.line_file import LineFile
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.mesh_report import MeshEntry
from sdm.cli.maps.work import MapTask
from sdm.io.files.leftovers import remove_leftovers
from sdm.io.files.stand_in import address_of


class MapManifest:
    """The manifest of a folder, a context manager. It stays if the work is cut off, and goes when it is done.

    Args:
        folder: Where maps go; None if nothing is to be kept.
        settings: What is the same for all meshes.
        resume: Whether lines of a run before count.
    """

    def __init__(self, folder: Path | None, settings: Settings, *, resume: bool) -> None:
        self._folder, self._resume = folder, resume
        self._lines = None if folder is None else LineFile(folder)
        self._is_far = folder is not None and address_of(folder) is not None
        # When the manifest of the run before was last brought, which all maps of its lines were before.
        self._before = 0
        self._settings = repr(replace(settings, device=torch.device("cpu"), resume=False, like_image=None))
        self._known: dict[str, dict[str, Any]] = {}
        if self._lines is not None and resume:
            self._read(self._lines)
        elif self._lines is not None and self._lines.path.exists():
            self._lines.remove()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._folder is not None and self._resume and kind is None:
            remove_leftovers(self._folder)
        if self._lines is not None:
            self._lines.close(whole=kind is None)

    def find(self, task: MapTask) -> MeshEntry | None:
        """Entry of a mesh whose map is there as it was written; None of another."""
        found = self._known.get(_name(task.target))
        if found is None or found["source"] != _mark(task.source):
            return None
        if not self._is_as_written(_mark(task.target), found["written"]):
            return None
        return replace(MeshEntry(**found["entry"]), state="there already", seconds=None)

    def add(self, task: MapTask, entry: MeshEntry) -> None:
        """Keep what is told of a mesh whose map is there.

        Raises:
            FormatError: The file cannot be written.
        """
        marks = _mark(task.source), _mark(task.target)
        if self._lines is None or None in marks:
            return
        line = {"settings": self._settings, "target": _name(task.target)}
        line |= {"source": marks[0], "written": marks[1], "entry": vars(entry)}
        self._lines.add(line)

    def _is_as_written(self, there: list[int] | None, written: list[int]) -> bool:
        if there is None or there == written or not self._is_far:
            return there == written
        # The server has put its own time on it, since when nobody wrote to it.
        return there[0] == written[0] and there[1] < self._before

    def _read(self, lines: LineFile) -> None:
        with contextlib.suppress(OSError):
            # The time of a server may be in whole seconds.
            self._before = lines.path.stat().st_mtime_ns + 10**9
        names = {one.name for one in fields(MeshEntry)}
        for found in lines.read():
            with contextlib.suppress(KeyError, TypeError, AttributeError):
                if found["settings"] == self._settings and found["entry"].keys() <= names:
                    self._known[found["target"]] = {key: found[key] for key in ("source", "written", "entry")}


def _name(path: Path) -> str:
    """A file by its path, or by the address that this stands for."""
    return address_of(path) or str(path.absolute())


def _mark(path: Path) -> list[int] | None:
    """Size and time of a file; None of what is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return [found.st_size, found.st_mtime_ns] if S_ISREG(found.st_mode) else None
