"""Surfaces of a folder that were finished, so that a run that was interrupted can go on: a line of JSON for each."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from sdm.errors import FormatError
from sdm.io.files.stand_in import address_of, bring, gone

NAME = "unfinished.jsonl"


class Journal:
    """Known facts of finished surfaces, by the file that each was written to.

    While a run goes on they are lines of a file of their own, `unfinished.jsonl`; `write_report` puts them into the
    report at its end, and the file goes.

    Args:
        folder: Where surfaces go; None if nothing is to be kept.
        report: The report of a run that came to its end.
        resume: Whether surfaces of runs before count.

    Raises:
        FormatError: A file that cannot be written.
    """

    def __init__(self, folder: Path | None, report: Path | None, *, resume: bool) -> None:
        self._path = None if folder is None else folder / NAME
        self._known: dict[str, dict[str, Any]] = {}
        if resume:
            self._read(report)
        elif self._path is not None:
            self._path.unlink(missing_ok=True)
            gone(self._path)

    def find(self, output: Path, made_from: str) -> dict[str, Any] | None:
        """Facts of a surface that is there as it was written, from the same mesh in the same way; None of another."""
        found = self._known.get(_name(output))
        if found is None or found.get("made_from") != made_from:
            return None
        with contextlib.suppress(OSError):
            if output.stat().st_size == found.get("bytes"):
                return found
        return None

    def add(self, output: Path, made_from: str, told: dict[str, Any]) -> dict[str, Any]:
        """Keep the facts of a surface that was written; returns them with its marks."""
        told = {**told, "output": _name(output), "made_from": made_from, "bytes": output.stat().st_size}
        if self._path is not None:
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    # The line before may be torn.
                    file.write("\n" + json.dumps(told))
            except OSError as error:
                raise FormatError(f"{self._path} cannot be written: {error.strerror or error}") from error
            bring(self._path, keep=True)
        return told

    def close(self) -> None:
        """Remove the lines: the report has them."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            gone(self._path)

    def _read(self, report: Path | None) -> None:
        lines: list[Any] = []
        if report is not None:
            with contextlib.suppress(OSError, ValueError, AttributeError):
                lines += json.loads(report.read_text(encoding="utf-8"))["surfaces"].values()
        if self._path is not None:
            with contextlib.suppress(OSError):
                for line in self._path.read_text(encoding="utf-8", errors="replace").splitlines():
                    # The last one may be torn.
                    with contextlib.suppress(ValueError):
                        lines.append(json.loads(line))
        self._known = {str(found["output"]): found for found in lines if isinstance(found, dict) and "output" in found}


def _name(output: Path) -> str:
    """A surface's file by its path, or by the address that this stands for."""
    return address_of(output) or str(output)
