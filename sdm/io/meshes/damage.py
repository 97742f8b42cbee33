"""Sentences about files that hold less than they declare."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdm.errors import MeshError


def require_count(path: Path, found: int, declared: int, what: str) -> None:
    """Refuse a file that is shorter than its header says.

    Raises:
        MeshError: `found` is less than `declared`.
    """
    if found < declared:
        raise MeshError(f"{path} is cut off or damaged: its header promises {declared} {what}, and {found} are there")


def require_coordinates(path: Path, lengths: np.ndarray, needed: int = 3) -> None:
    """Refuse vertices whose lines are too short for three coordinates.

    Raises:
        MeshError: One of `lengths`, the numbers on each vertex's line, is less than 3, or than the `needed` ones.
    """
    if len(lengths) and lengths.min() < 3:
        raise MeshError(f"a vertex of {path} has fewer than 3 coordinates; each needs x, y and z")
    if len(lengths) and lengths.min() < needed:
        raise MeshError(f"{path} is cut off or damaged: a vertex has {lengths.min()} of its {needed} values")


def require_corners(path: Path, found: np.ndarray, declared: np.ndarray) -> None:
    """Refuse faces with fewer corners than they declare.

    Raises:
        MeshError: Names the first face with `found` (F,) less than `declared` (F,).
    """
    short = np.flatnonzero(found < declared)
    if len(short):
        face = int(short[0])
        raise MeshError(
            f"{path} holds less than it says, it is cut off or damaged: face {face} of {len(found)} declares "
            f"{int(declared[face])} corners, and {max(int(found[face]), 0)} are there"
        )
