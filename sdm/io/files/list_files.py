"""Visible entries of a folder."""

from __future__ import annotations

from pathlib import Path


def visible(folder: Path) -> list[Path]:
    """A folder's entries by name; no hidden ones, such as macOS lays beside others."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
