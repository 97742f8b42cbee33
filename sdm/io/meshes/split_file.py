"""Split of a folder of meshes into parts, kept beside them: lists of files, by their paths below the folder."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Any

from sdm.errors import FormatError
from sdm.io.files.json_file import write_json

NAME, VERSION = "split.json", 1


def write_split(path: Path, parts: dict[str, list[str]], **more: Any) -> None:
    """Write the lists of the parts, and what else there is to tell of how they came about."""
    write_json(path, {"version": VERSION, **more, "parts": parts})


def read_split(path: Path) -> dict[str, list[str]]:
    """The lists of the parts.

    Args:
        path: The file, or the folder that it lies in as `split.json`.

    Raises:
        FormatError: It is not there, damaged, or of a newer version of sdm.
    """
    file = path / NAME if path.is_dir() else path
    try:
        found = json.loads(file.read_text())
        parts = found["parts"]
        good = all(isinstance(own, list) and all(isinstance(name, str) for name in own) for own in parts.values())
    except FileNotFoundError:
        raise FormatError(f"there is no {file}: sdm split makes it") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        good, found, parts = False, {}, {}
    if not good:
        raise FormatError(f"{file} is not a split that sdm split wrote")
    if found.get("version", 0) > VERSION:
        raise FormatError(f"{file} was written by a newer version of sdm: update it to read this split")
    return parts


def files_of_part(folder: Path, part: str, files: list[Path]) -> list[Path]:
    """Those of the mesh files of a folder that are in a part of its split, in their order.

    Raises:
        FormatError: There is no such part, or a file of it is gone.
    """
    parts = read_split(folder)
    if part not in parts:
        raise FormatError(f"the split of {folder} has no part {part!r}, but {', '.join(parts)}")
    wanted = {PurePosixPath(name) for name in parts[part]}
    found = {PurePosixPath(file.relative_to(folder).as_posix()): file for file in files}
    if missing := sorted(map(str, wanted - set(found))):
        raise FormatError(f"{len(missing)} files of the part {part!r} are not in {folder}, the first {missing[0]}")
    return [file for place, file in found.items() if place in wanted]
