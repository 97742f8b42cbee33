"""Logs of trainings and ensembles: a file of JSON lines for each study, one log a line, in the order of their names.

FILE.jsonl holds a study. FILE.jsonl/NAME is one trial of those that share a file; its lines say so with a `trial`.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import put
from sdm.errors import FormatError
from sdm.io.files.lock import alone

SUFFIX = ".jsonl"
Job = dict[str, Any]
Log = dict[str, Any]


@dataclass(frozen=True)
class LogFile:
    """The logs of a study, or of one trial of several in a file.

    Args:
        path: The file, which need not be there.
        trial: Name of the trial; None for the lines that belong to none.
    """

    path: Path
    trial: str | None = None

    @property
    def name(self) -> str:
        return self.path.stem if self.trial is None else self.trial

    def __str__(self) -> str:
        return str(self.path if self.trial is None else self.path / self.trial)

    def resolve(self) -> LogFile:
        return LogFile(self.path.resolve(), self.trial)

    def trials(self) -> dict[str, LogFile]:
        """The trials that share the file, by name."""
        names = {line["trial"] for line in self._lines() if "trial" in line}
        return {name: LogFile(self.path, name) for name in sorted(names)}

    def trainings(self) -> list[Log]:
        """Logs of trainings, by name."""
        return [log for log in self._own() if not _of_several(log)]

    def ensembles(self) -> list[Log]:
        """Logs of ensembles, by name: their jobs have `seeds` in place of one."""
        return [log for log in self._own() if _of_several(log)]

    def names(self) -> set[str]:
        return {log["job"]["name"] for log in self._own()}

    def put(self, log: Log) -> None:
        """Add a log, in place of one of the same name; atomic, also where several processes do so at a time.

        Numbers get five digits, infinities become words.
        """
        own = {} if self.trial is None else {"trial": self.trial}
        line = {**own, **short(log)}
        self._write(lambda lines: [*(other for other in lines if _key(other) != _key(line)), line])

    def remove(self, name: str) -> None:
        """Take a log out, if it is there; atomic."""
        if self.path.is_file():
            self._write(lambda lines: (line for line in lines if _key(line) != (self.trial or "", name)))

    def _own(self) -> list[Log]:
        own = (line for line in self._lines() if line.get("trial") == self.trial)
        return [{key: _long(value) for key, value in line.items() if key != "trial"} for line in own]

    def _lines(self) -> list[Log]:
        if not self.path.is_file():
            return []
        found = []
        for number, line in enumerate(self.path.read_text().splitlines(), 1):
            try:
                found.append(json.loads(line))
            except ValueError as error:
                raise FormatError(f"{self.path}, line {number}, is not JSON: {error}") from error
        return sorted(found, key=_key)

    def _write(self, change: Callable[[list[Log]], Iterable[Log]]) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with alone(self.path.parent, wait=True):
            lines = sorted(change(self._lines()), key=_key)
            text = (json.dumps(line, allow_nan=False, separators=(",", ":")) for line in lines)
            put(self.path, "".join(f"{line}\n" for line in text))


def log_file(text: str) -> LogFile:
    """An option's value: FILE.jsonl, or FILE.jsonl/TRIAL."""
    path = Path(text)
    if path.suffix == SUFFIX:
        return LogFile(path)
    if path.parent.suffix == SUFFIX:
        return LogFile(path.parent, path.name)
    raise argparse.ArgumentTypeError(f"{text} is no log file: give FILE{SUFFIX}, or FILE{SUFFIX}/TRIAL for a trial's")


def groups_of(job: Job) -> list[Job]:
    """Groups of networks that an ensemble averages: its own, then those of other protocols; each `settings`, `seeds`.

    A training is one such group.
    """
    return [job, *job.get("beside", [])]


def is_mixed(log: Log) -> bool:
    """True if a log is of an ensemble over networks of more than one protocol."""
    return len(groups_of(log["job"])) > 1


def short(value: Any) -> Any:
    """A value as a log holds it."""
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [short(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else str(value)
    return value


def _long(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _long(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_long(item) for item in value]
    return float(value) if value in ("inf", "-inf", "nan") else value


def _of_several(log: Log) -> bool:
    return "seeds" in log["job"]


def _key(line: Log) -> tuple[str, str]:
    return line.get("trial", ""), line["job"]["name"]
