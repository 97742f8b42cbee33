"""Folders of the checkout that this copy runs from, if it runs from one: its root, its results, the data beside it."""

from __future__ import annotations

import os
from pathlib import Path


def checkout() -> Path | None:
    """The root of the checkout, None for an installed copy."""
    root = Path(__file__).resolve().parents[2]
    return root if (root / "pyproject.toml").is_file() else None


def results_folder() -> Path:
    """Default folder of results: `bench/results` of the checkout; an installed copy writes to the current folder."""
    root = checkout()
    return Path() if root is None else root / "bench" / "results"


def docs_folder() -> Path:
    """Default folder of pictures: `docs` of the checkout; an installed copy writes to the current folder."""
    root = checkout()
    return Path() if root is None else root / "docs"


def data_folder() -> Path:
    """Folder of the real meshes and images: the environment variable SDM_DATA, else `../shared/data`."""
    return Path(os.environ.get("SDM_DATA") or (checkout() or Path()) / ".." / "shared" / "data")


def within_checkout(path: Path) -> str:
    """A path for a page: relative to the checkout if it lies in it."""
    root = checkout()
    inside = root is not None and path.resolve().is_relative_to(root)
    return str(path.resolve().relative_to(root) if inside and root is not None else path)
