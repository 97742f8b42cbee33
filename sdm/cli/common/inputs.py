"""Check of names: a command that would write over what it reads, or over its own output, is refused before any work."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from sdm.errors import FormatError


def refuse_inputs(targets: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Refuse to write over a file that is read, under whatever name; None stands for an option that is not given.

    Raises:
        FormatError: A target is an input.
    """
    read = {found for path in inputs if (found := _identity(path)) is not None}
    for target in targets:
        if _identity(target) in read:
            raise FormatError(f"{target} is an input too, and would be lost: choose another name for the output")


def refuse_twice(target: Path | None, others: Iterable[Path | None]) -> None:
    """Refuse an output that has the name of another; None stands for one that is not asked for.

    Raises:
        FormatError: One would replace the other.
    """
    # Of very many outputs those alone are looked up that are called alike.
    alike = [] if target is None else [other for other in others if other is not None and other.name == target.name]
    # Not by Path.resolve, which raises where a link leads to itself.
    if target is not None and os.path.realpath(target) in map(os.path.realpath, alike):
        raise FormatError(f"{target} is given for two outputs, and one would replace the other: name two files")


def _identity(path: Path | None) -> tuple[int, int] | None:
    """Device and inode of a file, the same for all its names and links; None if there is no file to lose."""
    if path is None:
        return None
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino
