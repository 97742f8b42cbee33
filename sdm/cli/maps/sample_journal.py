"""Journal of `sdm sample`: entries of meshes that are done, so that the report of a resumed run tells them again."""

from __future__ import annotations

import contextlib
import json
from dataclasses import fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sdm.cli.maps.line_file import LineFile
from sdm.cli.maps.mesh_report import MeshEntry


class SampleJournal:
    """Entries of meshes by their numbers, a context manager: a line each while the work goes on, then the report.

    Args:
        folder: Of the samples.
        report: The report of a run that came to its end.
        meshes: How many there are.
        resume: Whether what runs before have told counts.
    """

    def __init__(self, folder: Path, report: Path, meshes: int, *, resume: bool) -> None:
        self._lines = LineFile(folder)
        self._known: dict[int, MeshEntry] = {}
        if resume:
            self._read(report, meshes)
        elif self._lines.path.exists():
            self._lines.remove()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lines.close(whole=kind is None)

    @property
    def known(self) -> frozenset[int]:
        """Numbers of meshes of which runs before have told."""
        return frozenset(self._known)

    def told(self, number: int, entry: MeshEntry) -> MeshEntry:
        """A mesh's entry for the report: of samples that are there already, with what was told when they were made.

        Raises:
            FormatError: A line cannot be kept.
        """
        if entry.state == "done":
            self._lines.add({"number": number, "entry": vars(entry)})
        elif entry.state == "there already" and (before := self._known.get(number)) is not None:
            return replace(before, mesh=entry.mesh, state=entry.state, seconds=None)
        return entry

    def _read(self, report: Path, meshes: int) -> None:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            entries = json.loads(report.read_text(encoding="utf-8"))["meshes"]
            if len(entries) == meshes:
                for number, entry in enumerate(entries):
                    self._keep(number, entry)
        for line in self._lines.read():
            self._keep(line.get("number"), line.get("entry"))

    def _keep(self, number: Any, entry: Any) -> None:
        names = {one.name for one in fields(MeshEntry)}
        if isinstance(number, int) and isinstance(entry, dict) and entry.keys() <= names:
            with contextlib.suppress(TypeError):
                if (found := MeshEntry(**entry)).state != "failed":
                    self._known[number] = found
