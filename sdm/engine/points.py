"""Signed distances of scattered points, and an index of a mesh for them alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, Literal, overload

import torch
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.engine.acceleration import AccelerationStructure, MeshKind, build
from sdm.engine.arguments import Sign, SignMethod
from sdm.engine.closest_points import Closest
from sdm.engine.ops import points_closest, points_distance
from sdm.engine.plan_override import OPTIONS
from sdm.engine.repeated_faces import RepeatedFaces, may_be_crowded, repeated_faces
from sdm.errors import MeshError, SDMError
from sdm.kernels.points.plan import plan_points
from sdm.kernels.winding.winding_number import Winding
from sdm.runtime.torch_warp import refuse_other_modes
from sdm.topology.boundary_edges import boundary_edges


def as_points(points: Any, device: torch.device) -> Tensor:
    """Points (...,3) float32 on a device."""
    at = as_tensor(points, torch.float32, "the points", device=device)
    if at.ndim == 0 or at.shape[-1] != 3:
        raise MeshError(f"the points have shape {tuple(at.shape)}; (..., 3) is needed")
    refuse_other_modes(at)
    return at


def check_sign_at_points(sign: Sign) -> None:
    """Refuse a sign that points have not.

    Raises:
        SDMError: It is "flood", or none at all.
    """
    if SignMethod(sign).sign == "flood":
        raise SDMError("a flood needs the voxels of a grid to go through: sign='flood' is for maps, not for points")


def at_points(
    mesh: TriangleMesh,
    points: Any,
    return_closest: bool,
    structure: AccelerationStructure | None,
    repeated: RepeatedFaces | None = None,
    whole: TriangleMesh | None = None,
    sign: Sign = "winding",
) -> Tensor | tuple[Tensor, Closest]:
    """Signed distances of points from a mesh, as `sdm.signed_distance` gives them.

    Args:
        mesh: The mesh, on its device.
        points: (...,3).
        return_closest: Also return where the closest points are.
        structure: The mesh's, or None to build it here.
        repeated: The triangles that it has many times, if it has such.
        whole: The mesh with all of these.
        sign: "winding", or "none" for unsigned distances.

    Raises:
        SDMError: Another sign.
    """
    check_sign_at_points(sign)
    if sign == "none":
        found = _distances(mesh, points, return_closest, without_sign(structure or unbounded(mesh)), repeated, whole)
        # Nothing changes but gradients on the surface, which are zero.
        return found.abs() if isinstance(found, Tensor) else (found[0].abs(), found[1])
    return _distances(mesh, points, return_closest, structure, repeated, whole)


def search_needs_tree_alone(device: torch.device) -> bool:
    """True if points are searched without lists of triangles, so that a structure for them alone is a tree."""
    return not plan_points(1, device.type == "cuda", OPTIONS.get()).lists


def unbounded(mesh: TriangleMesh) -> AccelerationStructure:
    """The structure of a mesh whose boundary nobody asks for."""
    alone = search_needs_tree_alone(mesh.device)
    return build(mesh.vertices.detach()[None], mesh.faces, mesh.faces.new_empty((0, 2)), tree_alone=alone)


@cache
def unsigned_winding() -> Any:
    """The kernels' `Winding` of points whose side nobody asks for, without data. Nobody may write into it."""
    winding = Winding()
    winding.kind = int(MeshKind.UNSIGNED)
    return winding


def without_sign(structure: AccelerationStructure) -> AccelerationStructure:
    """The same arrays, for distances of at least 0."""
    sizes = structure.sizes._replace(kind=MeshKind.UNSIGNED)
    return replace(structure, sizes=sizes, view=structure.view._replace(winding=unsigned_winding()))


def _distances(
    mesh: TriangleMesh,
    points: Any,
    return_closest: bool,
    structure: AccelerationStructure | None,
    repeated: RepeatedFaces | None,
    whole: TriangleMesh | None,
) -> Tensor | tuple[Tensor, Closest]:
    at = as_points(points, mesh.device)
    shape, at = at.shape[:-1], at.reshape(-1, 3)
    # Without a sign copies change nothing but the names of faces.
    signed = repeated if structure is None or structure.kind is not MeshKind.UNSIGNED else None
    if not return_closest and not (at.requires_grad or mesh.vertices.requires_grad):
        values = points_distance(mesh.vertices, mesh.faces, at, structure)
        return (values if signed is None else signed.signed(values, at)).reshape(shape)
    values, point, face, barycentric = points_closest(mesh.vertices, mesh.faces, at, structure)
    if signed is not None:
        values = signed.signed(values, at)
    if repeated is not None:
        face = repeated.faces(face)
    values = values.reshape(shape)
    if not return_closest:
        return values
    hit = point.reshape(*shape, 3), face.reshape(shape), barycentric.reshape(*shape, 3)
    return values, Closest(*hit, mesh if whole is None else whole, at.detach())


class PointsIndex:
    """A mesh with what a search at points needs: built once, queried often; on a CPU in less time than a `MeshIndex`.

    Args:
        mesh: The mesh, or whatever `as_mesh` takes for one; taken as it is, without warnings.
        device: By default the mesh's own if that is a GPU, else a GPU if there is one, else the CPU.

    Raises:
        DeviceError: The device is not there.
    """

    def __init__(self, mesh: MeshLike, device: str | torch.device | None = None) -> None:
        whole = mesh if isinstance(mesh, TriangleMesh) else as_mesh(mesh)
        self.device = choose_device(device, whole.vertices)
        self.mesh = measured = whole.to(self.device)
        edges = boundary_edges(measured.vertices, measured.faces)
        self._repeated = repeated_faces(measured) if may_be_crowded(measured, edges) else None
        if self._repeated is not None:
            measured, edges = self._repeated.distinct, None
        self._measured = measured
        vertices, alone = measured.vertices.detach()[None], search_needs_tree_alone(self.device)
        self._structure = build(vertices, measured.faces, edges, tree_alone=alone)

    @overload
    def signed_distance(
        self, points: Any, *, return_closest: Literal[False] = False, sign: Sign = "winding"
    ) -> Tensor: ...
    @overload
    def signed_distance(
        self, points: Any, *, return_closest: Literal[True], sign: Sign = "winding"
    ) -> tuple[Tensor, Closest]: ...
    def signed_distance(
        self, points: Any, *, return_closest: bool = False, sign: Sign = "winding"
    ) -> Tensor | tuple[Tensor, Closest]:
        """As `sdm.signed_distance`, bit for bit."""
        return at_points(self._measured, points, return_closest, self._structure, self._repeated, self.mesh, sign)
