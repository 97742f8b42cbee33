"""Files of a dataset's shards: where each is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Axes of each array.
AXES = {"sdm": 4, "theta": 2, "transform": 3, "sha256": 2}


def rows_of(manifest: dict[str, Any], number: int) -> tuple[int, int]:
    """First sample of a shard, and the one after its last."""
    begin = number * manifest["shard"]
    return begin, min(begin + manifest["shard"], manifest["count"])


def files_of(folder: Path, manifest: dict[str, Any], number: int) -> list[Path]:
    """The files of a shard, the maps last."""
    return [file_of(folder, name, number) for name in arrays_of(manifest)]


def arrays_of(manifest: dict[str, Any]) -> tuple[str, ...]:
    """The arrays whose files a shard has."""
    return ("theta", "transform", "sdm") if manifest["transforms"] else ("theta", "sdm")


def file_of(folder: Path, name: str, number: int) -> Path:
    """File of a shard's part of an array."""
    return (folder / name / "c" / str(number)).joinpath(*["0"] * (AXES[name] - 1))


def checksum_file(folder: Path, number: int) -> Path:
    """File of a shard's checksum, 32 bytes."""
    return file_of(folder, "sha256", number)
