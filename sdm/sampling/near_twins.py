"""Near twins among shapes, by exact distances both ways once laid on each other, and splits that keep them together.

Scans of one patient, or one label cut differently, are far nearer to each other than two patients are. A test shape
with such a twin in training says how well a network remembers. `near_twins` finds them, `split_groups` deals whole
groups of them to training, validation and test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.core.random import generator
from sdm.engine.mesh_index import MeshIndex
from sdm.sampling.surface_points import surface_points

# Points of each surface that two shapes are laid on each other by, and those of the distance that is reported.
ALIGNED_BY, MEASURED_BY = 300, 2000
STEPS = 8


class Surface:
    """A mesh that can be asked for nearest points, and random points of it.

    Args:
        mesh: The mesh.
        device: Where to measure.
    """

    def __init__(self, mesh: TriangleMesh, device: str | torch.device = "cpu") -> None:
        self.index = MeshIndex(mesh, device, warn=False)
        self.few = surface_points(self.index.mesh, ALIGNED_BY, seed=1)[0].double()
        self.many = surface_points(self.index.mesh, MEASURED_BY, seed=2)[0].double()

    def nearest(self, points: Tensor) -> Tensor:
        """Nearest points (N,3) float64 of the surface to points (N,3)."""
        return self.index.signed_distance(points.float(), return_closest=True)[1].points.double()


def laid_on(
    moving: Surface, fixed: Surface, *, seen: Tensor | None = None, steps: int = STEPS
) -> tuple[Tensor, Tensor]:
    """The rotation (3,3) and the shift (3,) that lay `moving` on `fixed`: p becomes p R^T + t; float64.

    Iterated closest points both ways from laid-on centres, without a turn to begin with: scans of one kind face alike.
    Where only a part of `fixed` is seen, from where `moving` is.

    Args:
        moving: What is moved.
        fixed: What it is laid on.
        seen: Points (N,3) that are all that is known of `fixed`; then distances count from these to `moving` alone.
        steps: Iterations.
    """
    here = fixed.few if seen is None else seen.double()
    turn = torch.eye(3, dtype=torch.float64, device=here.device)
    # The centre of a part is not that of the whole.
    shift = here.mean(0) - moving.few.mean(0) if seen is None else torch.zeros_like(here[0])
    for _ in range(steps):
        # In the moving shape's own coordinates, so that neither tree is built again.
        back = moving.nearest((here - shift) @ turn)
        source, target = back, here
        if seen is None:
            placed = moving.few @ turn.T + shift
            source, target = torch.cat([back, moving.few]), torch.cat([here, fixed.nearest(placed)])
        turn, shift = _rigid(source, target)
    return turn, shift


def distance_between(a: Surface, b: Surface) -> float:
    """Mean distance between two surfaces, the mean of both ways, once `a` is laid on `b`; in the meshes' unit."""
    turn, shift = laid_on(a, b)
    there = a.many @ turn.T + shift
    back = (b.many - shift) @ turn
    return (_mean_distance(there, b.nearest(there)) + _mean_distance(back, a.nearest(back))) / 2


def distances_between(meshes: Sequence[TriangleMesh], device: str | torch.device = "cpu") -> Tensor:
    """Mean distances (M,M) between all meshes, each laid on each other; float64, zero on the diagonal."""
    surfaces = [Surface(mesh, device) for mesh in meshes]
    found = torch.zeros(len(meshes), len(meshes), dtype=torch.float64, device="cpu")
    for i, j in combinations(range(len(meshes)), 2):
        found[i, j] = found[j, i] = distance_between(surfaces[i], surfaces[j])
    return found


def near_twins(distances: Tensor, limit: float) -> list[list[int]]:
    """Groups of shapes that a chain of distances (M,M) below the limit joins; a shape without a twin is alone."""
    group = list(range(len(distances)))
    for i, j in combinations(group.copy(), 2):
        if distances[i, j] < limit:
            old, new = max(group[i], group[j]), min(group[i], group[j])
            group = [new if g == old else g for g in group]
    return [[n for n, g in enumerate(group) if g == own] for own in sorted(set(group))]


def split_groups(
    groups: Sequence[Sequence[str]], sizes: Mapping[str, int], rest: str, *, seed: int = 0
) -> dict[str, list[str]]:
    """Deal whole groups to parts, in an order drawn from the seed.

    Args:
        groups: Names of shapes; those of one group stay together.
        sizes: Part -> how many shapes at least; a part is full before the next one gets any.
        rest: The part that everything else goes to.
        seed: Of the order.
    """
    order: list[int] = torch.randperm(len(groups), device="cpu", generator=generator(seed, "order of groups")).tolist()
    parts: dict[str, list[str]] = {**{name: [] for name in sizes}, rest: []}
    for number in order:
        name = next((n for n, size in sizes.items() if len(parts[n]) < size), rest)
        parts[name].extend(groups[number])
    return {name: sorted(part) for name, part in parts.items()}


def _rigid(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Least squares: the turn R and shift t for which source R^T + t is nearest to target (W. Kabsch, 1976)."""
    middle, other = source.mean(0), target.mean(0)
    u, _, vt = torch.linalg.svd((source - middle).T @ (target - other))
    # No mirror image.
    sign = torch.ones(3, dtype=source.dtype, device=source.device)
    sign[2] = torch.sign(torch.linalg.det(u) * torch.linalg.det(vt))
    turn = (vt.T * sign) @ u.T
    return turn, other - turn @ middle


def _mean_distance(a: Tensor, b: Tensor) -> float:
    return float((a - b).norm(dim=1).mean())
