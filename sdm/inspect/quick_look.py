"""Quick look at how faces face: for most meshes it tells that there is nothing to say."""

from __future__ import annotations

from weakref import ref

import numpy as np
import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.core.mesh import TriangleMesh
from sdm.inspect.edges import label
from sdm.inspect.orientation import outward_turns
from sdm.inspect.positions import first_at_position
from sdm.inspect.report import inspect_mesh

# A volume below this share of what the area could enclose is none.
LEAST_VOLUME = 1e-9
# Faces whose components are found step by step.
MOST_BY_STEPS = 20_000


class MeshLook:
    """Findings about how a mesh's faces face, made when they are needed.

    Args:
        mesh: The mesh, on any device.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._faces = ref(mesh.faces)
        self._states = _states(mesh)
        self._plain: bool | None = None
        self._problems: list[str] | None = None
        # Of the faces alone: whoever keeps a mesh keeps its vertices, and so this.
        self._outward: list[Tensor] | None = None

    def is_of(self, mesh: TriangleMesh) -> bool:
        """True if the look was at this mesh, and torch has written nothing into it since."""
        return self._states is not None and self._faces() is mesh.faces and self._states == _states(mesh)

    def is_plain(self, mesh: TriangleMesh) -> bool:
        """True if faces agree and every component faces outward, which is found by less than `inspect_mesh`."""
        if self._plain is None:
            self._plain = _is_plain(mesh)
        return self._plain

    def problems(self, mesh: TriangleMesh) -> list[str]:
        """The `sign_problems` of `inspect_mesh`."""
        if self._problems is None:
            self._problems = [] if self.is_plain(mesh) else inspect_mesh(mesh).sign_problems
        return self._problems

    def outward_faces(self, mesh: TriangleMesh) -> Tensor | None:
        """The faces (F,3) of `orient_outward`; None if they are the mesh's own."""
        if self._outward is None:
            self._outward = [] if self.is_plain(mesh) else _turned(mesh)
        return self._outward[0] if self._outward else None


_known: WeakIdKeyDictionary = WeakIdKeyDictionary()


def look_at(mesh: TriangleMesh) -> MeshLook:
    """The findings about a mesh, remembered as long as its vertices live and nothing is written into it."""
    known: MeshLook | None = _known.get(mesh.vertices)
    if known is None or not known.is_of(mesh):
        known = MeshLook(mesh)
        _known[mesh.vertices] = known
    return known


def _states(mesh: TriangleMesh) -> tuple[int, int] | None:
    if mesh.vertices.is_inference() or mesh.faces.is_inference():
        return None
    return mesh.vertices._version, mesh.faces._version


def _turned(mesh: TriangleMesh) -> list[Tensor]:
    vertices, faces = mesh.numpy()
    turn = outward_turns(vertices[faces].astype(np.float64), first_at_position(vertices)[faces.astype(np.int64)])
    if not turn.any():
        return []
    return [torch.from_numpy(np.where(turn[:, None], faces[:, ::-1], faces)).to(mesh.device)]


def _is_plain(mesh: TriangleMesh) -> bool:
    """True if no edge is left over twice and no component encloses less than nothing, nor nothing if it is closed."""
    # `sdm inspect` needs nothing of Warp, whose start takes a third of a second.
    from sdm.topology.boundary_edges import boundary_edges
    from sdm.topology.face_pairing import pairing_of

    pairing = pairing_of(mesh.faces, mesh.vertices.shape[0])
    edges = boundary_edges(mesh.vertices, mesh.faces)
    # They are sorted.
    if bool((edges[1:] == edges[:-1]).all(1).any()):
        return False
    vertices, faces = mesh.numpy()
    around = pairing.neighbours
    if pairing.unmatched.shape[0]:
        merged = first_at_position(vertices)[faces].astype(np.int32)
        around = pairing_of(torch.from_numpy(merged), len(vertices)).neighbours
    other = around.cpu().numpy()[:, :3] // 3
    component = _components(np.where(other < 0, np.arange(len(faces))[:, None], other))
    volume, area = _sizes(mesh, component)
    least = LEAST_VOLUME * area**1.5
    return bool((volume > -least if edges.shape[0] else volume > least).all())


def _components(other: np.ndarray) -> np.ndarray:
    """The number of the component of each face, given three faces (F,3) that it meets, itself where there is none."""
    count = len(other)
    if count > MOST_BY_STEPS:
        return label(np.repeat(np.arange(count), 3), other.reshape(-1), count)
    # Without SciPy, whose import takes longer: each takes the least number near it, and what that one has taken.
    lowest, before = np.arange(count), None
    while before is None or not np.array_equal(lowest, before):
        before = lowest
        lowest = np.minimum(before, before[other].min(1))
        lowest = lowest[lowest]
    return np.unique(lowest, return_inverse=True)[1].reshape(-1)


def _sizes(mesh: TriangleMesh, component: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed volume of each component about its middle, and its area."""
    vertices = mesh.vertices.detach().double().cpu()
    # About the middle of all, so that a mesh far from the origin loses no digits.
    vertices = vertices - vertices.mean(0)
    a, b, c = (vertices.index_select(0, mesh.faces[:, k].long().cpu()) for k in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    of_face = torch.cat([a + b + c, normal, (a * normal).sum(1, True), normal.norm(dim=1, keepdim=True)], 1)
    number = torch.from_numpy(component).long()
    sums = of_face.new_zeros(int(number.max()) + 1, 8).index_add_(0, number, of_face)
    middle = sums[:, :3] / (3 * torch.bincount(number)[:, None])
    volume = (sums[:, 6] - (middle * sums[:, 3:6]).sum(1)) / 6
    return volume.numpy(), (sums[:, 7] / 2).numpy()
