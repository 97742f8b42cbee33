"""Split of a folder of meshes into training, validation and test, with groups and near twins kept on one side."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError, SDMError
from sdm.io import load_mesh
from sdm.runtime.pipeline.outcome import Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import in_threads, numbered
from sdm.runtime.pipeline.thread_count import threads_beside
from sdm.sampling.near_twins import Surface, distance_between, split_groups

REST = "train"
# Shapes whose principal deviations differ by more than so many tolerances are not laid on each other.
SLACK = 4.0
# Surfaces that are kept ready.
KEPT = 64
# Called with how many of how many are done, and of what.
Counted: TypeAlias = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Twins:
    """Two meshes that are nearly the same: their numbers, and the mean distance both ways, in their unit."""

    one: int
    other: int
    distance: float


@dataclass(frozen=True)
class FolderSplit:
    """A split.

    Args:
        parts: Part -> paths of its meshes below the folder, sorted.
        twins: Pairs of near twins, by the paths, with their distance.
        skipped: (path, reason) of meshes that could not be read.
    """

    parts: dict[str, list[str]]
    twins: list[tuple[str, str, float]] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)


def split_folder(
    names: Sequence[str],
    files: Sequence[Path],
    shares: dict[str, float],
    *,
    seed: int = 0,
    twins: float = 0.01,
    group: str | None = None,
    device: str | torch.device = "cpu",
    progress: Counted | None = None,
) -> FolderSplit:
    """Deal meshes to parts.

    Args:
        names: Their paths below the folder.
        files: Where they are.
        shares: Part -> share of the meshes, at least; the rest is "train".
        seed: Of the order in which groups are dealt.
        twins: Meshes whose mean distance both ways, once one is shifted and turned a little to lie on the other, is
            below this share of their size are kept together; 0 looks for none. Size is the root mean square distance
            of the surface from its middle. Copies that are turned by much, or scaled, are not found.
        group: Regular expression; meshes with the same match in their paths, of its first group if it has one, are kept
            together, such as "^[^/]+" for the first folder.
        device: Where distances are measured.
        progress: Called with how many are done, how many there are, and of what: meshes that are read, then pairs
            that are compared.

    Raises:
        SDMError: Shares that make no sense, an expression that is none.
        MeshError: No mesh can be used.
    """
    if not all(0 < share < 1 for share in shares.values()) or sum(shares.values()) >= 1:
        told = " and ".join(f"{share:g} for {part}" for part, share in shares.items())
        raise SDMError(f"shares of {told} leave nothing for {REST}: give shares above 0 that sum to less than 1")
    if not (math.isfinite(twins) and twins >= 0):
        raise SDMError(f"twins are {twins:g} of their size apart; give a share of at least 0")
    # Looked at before meshes are read and measured.
    groups = {} if group is None else _by_expression(names, group)
    shapes, skipped = _shapes(names, files, torch.device(device), progress)
    if not shapes:
        raise MeshError(
            f"none of {len(names)} meshes can be used; of the first, {skipped[0][1] if skipped else 'none'}"
        )
    found = find_twins(shapes, [files[n] for n in shapes], twins, device, progress) if twins > 0 else []
    order = list(shapes)
    together = _Groups(len(order))
    for pair in found:
        together.join(pair.one, pair.other)
    first: dict[str, int] = {}
    for at, number in enumerate(order):
        if number in groups:
            together.join(first.setdefault(groups[number], at), at)
    kept = [names[n] for n in order]
    sizes = {part: max(1, round(share * len(kept))) for part, share in shares.items()}
    parts = split_groups([[kept[n] for n in own] for own in together.groups()], sizes, REST, seed=seed)
    if not parts[REST]:
        raise SDMError(f"nothing is left for {REST}: the groups that are kept together are too large for these shares")
    return FolderSplit(parts, [(kept[p.one], kept[p.other], p.distance) for p in found], skipped)


def find_twins(
    shapes: dict[int, np.ndarray],
    files: Sequence[Path],
    tolerance: float,
    device: str | torch.device = "cpu",
    progress: Counted | None = None,
) -> list[Twins]:
    """Pairs of near twins, by their places among the shapes; see `split_folder`.

    Args:
        shapes: `deviations` of each.
        files: Their files.
        tolerance: As a share of the size of the smaller one.
        device: Where to measure.
        progress: See `split_folder`.
    """
    from scipy.spatial import KDTree

    known = np.stack(list(shapes.values()))
    size = np.linalg.norm(known, axis=1)

    @lru_cache(KEPT)
    def surface(number: int) -> Surface:
        return Surface(load_mesh(files[number]), device)

    near = KDTree(known).query_pairs(SLACK * tolerance * float(size.max()))
    limits = {(one, other): tolerance * min(size[one], size[other]) for one, other in sorted(near)}
    pairs = [pair for pair, limit in limits.items() if np.linalg.norm(known[pair[0]] - known[pair[1]]) <= SLACK * limit]
    found = []
    for done, (one, other) in enumerate(pairs):
        if progress is not None:
            progress(done, len(pairs), "pairs compared")
        distance = distance_between(surface(one), surface(other))
        if distance < limits[one, other]:
            found.append(Twins(one, other, distance))
    return found


def deviations(mesh: TriangleMesh) -> np.ndarray:
    """Standard deviations (3,) float64 of a surface along its principal axes, by exact integrals over its triangles."""
    vertices, faces = mesh.numpy()
    corners = vertices.astype(np.float64)[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    if not area.sum() > 0:
        raise MeshError(f"every triangle of {mesh.name} has zero area; points of its surface need some")
    share = area / area.sum()
    corners = corners - (share @ corners.mean(1))
    total = corners.sum(1)
    # Over a triangle, the mean of x x^T is the sum of those of its corners and of their sum, over 12.
    second = np.einsum("f,fki,fkj->ij", share, corners, corners) + np.einsum("f,fi,fj->ij", share, total, total)
    return np.sqrt(np.clip(np.linalg.eigvalsh(second / 12), 0, None))


def _shapes(
    names: Sequence[str], files: Sequence[Path], device: torch.device, progress: Counted | None
) -> tuple[dict[int, np.ndarray], list[tuple[str, str]]]:
    """`deviations` of each mesh that can be read, by its number; and which ones cannot."""
    workers = min(threads_beside(device), max(1, len(files)))
    shapes: dict[int, np.ndarray] = {}
    skipped = []
    read = in_threads(
        numbered(files), "read", lambda file: deviations(load_mesh(file)), workers=workers, times=StageTimes()
    )
    for done, outcome in enumerate(read):
        if progress is not None:
            progress(done, len(files), "meshes read")
        if not isinstance(outcome, Failed):
            shapes[outcome.number] = outcome.value
        elif isinstance(outcome.error, SDMError):
            skipped.append((names[outcome.number], str(outcome.error)))
        else:
            raise outcome.error
    return shapes, skipped


def _by_expression(names: Sequence[str], group: str) -> dict[int, str]:
    """For the number of each mesh what the expression finds in its path, alike for those that stay together."""
    try:
        expression = re.compile(group)
    except re.error as error:
        raise SDMError(f"{group!r} is no regular expression: {error}") from error
    matches: dict[int, str] = {}
    for number, name in enumerate(names):
        found = expression.search(name)
        if found is None:
            raise SDMError(f"{group!r} matches nothing in {name}: every mesh needs a group")
        matches[number] = found[1] if expression.groups else found[0]
    return matches


class _Groups:
    """Sets of numbers that are joined pair by pair."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def _root(self, number: int) -> int:
        while self._parent[number] != number:
            self._parent[number] = self._parent[self._parent[number]]
            number = self._parent[number]
        return number

    def join(self, one: int, other: int) -> None:
        low, high = sorted((self._root(one), self._root(other)))
        self._parent[high] = low

    def groups(self) -> list[list[int]]:
        found: dict[int, list[int]] = {}
        for number in range(len(self._parent)):
            found.setdefault(self._root(number), []).append(number)
        return list(found.values())
