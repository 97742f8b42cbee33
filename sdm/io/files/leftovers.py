"""Removal of what killed processes have left of files that they were writing."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from sdm.io.files.atomic import LEFTOVER, machine, remove

NAME = re.compile(rf"\..+\.(\d+)-([0-9a-f]{{8}})[0-9a-f]{{8}}(-old)?{re.escape(LEFTOVER)}")


def remove_leftovers(folder: Path) -> None:
    """Remove unfinished files and folders in a folder, nested or not, whose process is gone.

    Those of other machines stay, which may be at work on a disk that is shared.
    """
    if os.name == "nt":
        # Whether a process is there cannot be asked without harm.
        return
    for root, folders, files in os.walk(folder):
        for name in [*folders, *files]:
            if _is_left(name):
                remove(Path(root) / name)


def remove_leftovers_of(target: Path) -> None:
    """Remove what processes that are gone have left beside one file or folder that they were writing."""
    if os.name == "nt":
        return
    with suppress(OSError):
        for path in target.parent.iterdir():
            if path.name.startswith(f".{target.name}.") and _is_left(path.name):
                remove(path)


def _is_left(name: str) -> bool:
    found = NAME.fullmatch(name)
    return found is not None and found[2] == machine() and not _is_there(int(found[1]))


def _is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        # Somebody else's.
        pass
    return True
