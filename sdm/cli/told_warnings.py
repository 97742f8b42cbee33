"""Warnings on stderr: the project's own, and those of other libraries, each in one line."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sdm.cli.common.printed_line import print_line
from sdm.errors import SDMWarning, one_line

# What developers of the libraries are to know, and users can do nothing about.
OF_NO_USE = (DeprecationWarning, PendingDeprecationWarning, FutureWarning, ImportWarning, ResourceWarning)


@contextmanager
def warnings_in_a_line() -> Iterator[None]:
    """Print warnings as commands print lines, the same one once; those of other libraries with their name."""
    told: set[str] = set()

    def tell(message: object) -> None:
        line = f"sdm: warning: {message}"
        if line not in told:
            told.add(line)
            print_line(line, error=True)

    def show(message: Warning | str, category: type[Warning], filename: str, *where: Any, **more: Any) -> None:
        if issubclass(category, SDMWarning):
            tell(message)
        elif not issubclass(category, OF_NO_USE):
            tell(f"{one_line(message)} ({_library(filename)})")

    # Of a logger without a handler, this one prints what it says as it is.
    usual, logging.lastResort = logging.lastResort, _Log(tell)
    with warnings.catch_warnings():
        warnings.simplefilter("always", SDMWarning)
        warnings.showwarning = show
        try:
            yield
        finally:
            logging.lastResort = usual


class _Log(logging.Handler):
    """Handler that tells what is logged as a warning or worse."""

    def __init__(self, tell: Any) -> None:
        super().__init__(logging.WARNING)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`."""
        self._tell(f"{one_line(record.getMessage())} ({record.name.partition('.')[0]})")


def _library(filename: str) -> str:
    """Name of the library that a file is of: the first part below the innermost place that imports come from."""
    path = Path(filename)
    places = [place for place in map(Path, sys.path) if place in path.parents]
    if not places:
        return path.stem
    return path.relative_to(max(places, key=lambda place: len(place.parts))).parts[0].removesuffix(".py")
