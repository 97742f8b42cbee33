"""Samples of one mesh: each a pure function of a seed, the mesh's name and its own number."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float32
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import SMALL, choose_device, free_memory, gibibytes
from sdm.core.given_values import whole
from sdm.core.mesh import TriangleMesh
from sdm.core.normalization import Normal, Normalization
from sdm.core.random import derive_seed
from sdm.engine.arguments import Orient, Sign, SignMethod, oriented
from sdm.engine.checks.digits_check import look_at_digits
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError, SDMError
from sdm.sampling.flood_sign import flood_signs
from sdm.sampling.law import PAPER, SURFACE, UNIFORM, SampleLaw
from sdm.sampling.surface_points import in_triangle, triangle_areas
from sdm.shapes.sampling import uniform

# Of a sample: its number and kind, point, normal and distance.
BYTES = 48


@dataclass(frozen=True, eq=False)
class PointSamples:
    """Samples of a mesh, in the unit that it was normalised to.

    Args:
        points: (N,3).
        distances: (N,), negative inside; of points on the surface 0.
        kinds: (N,) int64: 0 near the surface, 1 anywhere in the box, 2 on the surface.
        normalization: What the mesh went through; None if it stayed as it was.
        closest: (N,3) closest points of the surface, where they were wanted.
        normals: (N,3) unit normals of the faces there, as the mesh's faces face.
        unsure: Of a flood, how many samples have a sign that it does not prove.
    """

    points: Float32[Tensor, "n 3"]
    distances: Float32[Tensor, " n"]
    kinds: Tensor
    normalization: Normalization | None
    closest: Float32[Tensor, "n 3"] | None = None
    normals: Float32[Tensor, "n 3"] | None = None
    unsure: int = 0

    @property
    def occupancies(self) -> Tensor:
        """(N,) bool: True inside."""
        return self.distances < 0


def sample(
    mesh: MeshLike,
    count: int = 500_000,
    *,
    law: SampleLaw = PAPER,
    normalize: Normal | None = "sphere",
    seed: int = 0,
    name: str | None = None,
    first: int = 0,
    device: str | torch.device | None = None,
    orient: Orient = "auto",
    sign: Sign = "winding",
    hole_size: float | None = None,
    closest: bool = False,
) -> PointSamples:
    """Points with exact signed distances, as implicit networks are trained on.

    Args:
        mesh: Any triangles, as `sdm.signed_distance_map` takes them.
        count: Number of samples.
        law: Where they are; DeepSDF's by default.
        normalize: `"sphere"`, `"cube"` (see `Normalization`), or None to leave the mesh where it is. Samples, distances
            and the law's lengths are in the normalised unit.
        seed: Any whole number.
        name: What tells the mesh from others, for example its path in a dataset; the mesh's own name by default.
        first: Number of the first sample: 0 to 99 and 100 to 199 together are 0 to 199.
        device: Where to compute; by default a GPU if there is one.
        orient: As for `sdm.signed_distance_map`; by default faces that look inward are turned.
        sign: `"winding"`, `"flood"` (by a map of 128^3 voxels around the box), or `"none"` for unsigned distances.
        hole_size: Of a flood, in the normalised unit.
        closest: Also closest points and the normals of the faces there.

    Returns:
        The samples, on the device. Each is a pure function of (seed, name, its number) and the mesh, on one kind of
        device; distances are those of `sdm.signed_distance` at the points, on the surface 0.

    Raises:
        MeshError: The mesh has no size or no area.
        SDMError: A number that makes no sense, or more samples than fit into memory.
    """
    found = as_mesh(mesh)
    if whole(count, 1) is None or whole(first, 0) is None or (end := whole(first + count, 1)) is None:
        raise SDMError(f"{count!r} samples from number {first!r} were requested; give at least 1, from 0 or later")
    if not isinstance(law, SampleLaw):
        raise SDMError(f"the law is {law!r}; give a SampleLaw, such as sdm.sampling.PAPER")
    if not isinstance(name, str | None):
        raise SDMError(f"the name is {name!r}; give a text")
    SignMethod(sign, hole_size)
    where = choose_device(device, found.vertices)
    require_room(count, where)
    by = None if normalize is None else Normalization.of(found, normalize)
    look_at_digits(found)
    measured = oriented(found if by is None else by.normalised(found), orient, where).to(where)
    index = MeshIndex(measured, where, warn=False)
    numbers = torch.arange(first, end, dtype=torch.int64, device=where)
    points, normals = draw_points(index.mesh, law, mesh_seed(seed, name or found.name), numbers)
    return measure(index, points, law.kinds(numbers), normals, by, sign=sign, hole_size=hole_size, closest=closest)


def require_room(count: int, device: torch.device) -> None:
    """Refuse more samples than fit into memory.

    Raises:
        SDMError: Says how much they need and how much there is.
    """
    needed = BYTES * count
    if needed > SMALL and needed > (free := free_memory(device)):
        raise SDMError(
            f"{count:,} samples need {gibibytes(needed)}, but {device} has {gibibytes(free)} free: draw fewer"
        )


def measure(
    index: MeshIndex,
    points: Tensor,
    kinds: Tensor,
    normals: Tensor,
    normalization: Normalization | None,
    *,
    sign: Sign = "winding",
    hole_size: float | None = None,
    closest: bool = False,
) -> PointSamples:
    """Exact distances of points (N,3) of these kinds (N,), of which those on the surface have normals (N,3)."""
    unsure = 0
    asked: Sign = "winding" if sign == "winding" else "none"
    near = face_normals = None
    if closest or sign == "flood":
        distances, hit = index.signed_distance(points, return_closest=True, sign=asked)
        near = hit.points
        corners = index.mesh.vertices[index.mesh.faces[hit.faces.long().clamp(min=0)].long()]
        face_normals = _normals(corners)
        if sign == "flood":
            distances, unsure = flood_signs(index, points, distances, near, hole_size)
    else:
        distances = index.signed_distance(points, sign=asked)
    on = kinds == SURFACE
    distances = torch.where(on, torch.zeros_like(distances), distances)
    if not closest:
        near = face_normals = None
    elif near is not None and face_normals is not None:
        near, face_normals = torch.where(on[:, None], points, near), torch.where(on[:, None], normals, face_normals)
    return PointSamples(points, distances, kinds, normalization, near, face_normals, unsure)


def mesh_seed(seed: int, name: str) -> int:
    """The seed of a mesh's samples."""
    return derive_seed(seed, "samples of a mesh", name)


def draw_points(mesh: TriangleMesh, law: SampleLaw, seed: int, numbers: Tensor) -> tuple[Tensor, Tensor]:
    """Points (N,3) of the samples with these numbers (N,), and the normals (N,3) of the faces that they are drawn from.

    Raises:
        MeshError: Every triangle has zero area.
    """
    corners = mesh.vertices.detach()[mesh.faces.long()]
    # On the host: a GPU adds up in another order each time.
    total = triangle_areas(corners).cpu().cumsum(0).to(numbers.device)
    if not bool(total[-1] > 0):
        raise MeshError(f"every triangle of {mesh.name} has zero area; points of its surface need some")
    draws = uniform(seed, numbers, 8)
    # 24 random bits are too few to choose among millions of triangles, so two numbers make one.
    choice = (draws[:, 0].double() + draws[:, 1].double() * 2.0**-24) * total[-1]
    face = torch.searchsorted(total, choice, right=True).clamp(max=len(total) - 1)
    chosen = corners[face]
    kinds, on = law.kinds(numbers)[:, None], in_triangle(chosen, draws[:, 2:4])
    # Box and Muller: two pairs of numbers make four normal ones, of which three are used.
    radius = (-2 * torch.log1p(-draws[:, [4, 6]].double())).sqrt()
    angle = 2 * torch.pi * draws[:, [5, 7]].double()
    normal = torch.cat([radius * angle.cos(), radius[:, :1] * angle[:, :1].sin()], 1)
    near = (on.double() + law.deviation_of(numbers)[:, None] * normal).float()
    anywhere = law.box * (2 * draws[:, :3] - 1)
    return torch.where(kinds == UNIFORM, anywhere, torch.where(kinds == SURFACE, on, near)), _normals(chosen)


def _normals(corners: Tensor) -> Tensor:
    """Unit normals (N,3) float32 of triangles (N,3,3); zero for one without area."""
    wide = corners.detach().double()
    normal = torch.linalg.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    return torch.nn.functional.normalize(normal, dim=1, eps=0.0).nan_to_num(0.0).float()
