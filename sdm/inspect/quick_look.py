"""Quick look at how faces face: for most meshes it tells that there is nothing to say."""

from __future__ import annotations

from weakref import ref

import numpy as np
import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.core.mesh import TriangleMesh
from sdm.inspect.orientation import outward_turns
from sdm.inspect.positions import first_at_position
from sdm.inspect.report import inspect_mesh
from sdm.inspect.rounding import lost_digits

# A volume below this share of what the area could enclose is none.
LEAST_VOLUME = 1e-9
# A volume above this share is one, however it is added up.
PLAIN_VOLUME = 1e-6


class MeshLook:
    """Findings about how a mesh's faces face, made when they are needed.

    Args:
        mesh: The mesh, on any device.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._faces = ref(mesh.faces)
        self._states = _states(mesh)
        self._plain: bool | None = None
        self._closed: bool | None = None
        self._by_one_look: bool | None = None
        self._problems: list[str] | None = None
        self._lost_digits: list[str] | None = None
        # Of the faces alone: whoever keeps a mesh keeps its vertices, and so this.
        self._outward: list[Tensor] | None = None

    def is_of(self, mesh: TriangleMesh) -> bool:
        """True if the look was at this mesh, and torch has written nothing into it since."""
        return self._states is not None and self._faces() is mesh.faces and self._states == _states(mesh)

    def is_plain(self, mesh: TriangleMesh) -> bool:
        """True if faces agree and every component faces outward, which is found by less than `inspect_mesh`."""
        if self._plain is None:
            self._plain = self._is_plainly_closed(mesh) or _is_plain(mesh)
        return self._plain

    def is_closed(self, mesh: TriangleMesh) -> bool:
        """True if a mesh has no boundary. Of most meshes on the host one look tells this and that they are plain."""
        if self._closed is None:
            self._closed = (self._plain is None and self._is_plainly_closed(mesh)) or _is_closed(mesh)
        return self._closed

    def closes_plainly(self, mesh: TriangleMesh) -> bool:
        """True if one look finds a mesh on the host closed, every component facing outward. False says nothing."""
        if self._by_one_look is None:
            from sdm.topology.closed_look import is_plainly_closed

            self._by_one_look = is_plainly_closed(mesh.vertices, mesh.faces, PLAIN_VOLUME)
            if self._by_one_look:
                self._plain = self._closed = True
        return self._by_one_look

    def _is_plainly_closed(self, mesh: TriangleMesh) -> bool:
        from sdm.topology.face_pairing import is_known

        # What is paired already tells as much for less.
        if mesh.device.type != "cpu" or is_known(mesh.faces, mesh.vertices.shape[0]):
            return False
        return self.closes_plainly(mesh)

    def problems(self, mesh: TriangleMesh) -> list[str]:
        """The `sign_problems` of `inspect_mesh`."""
        if self._problems is None:
            self._problems = [] if self.is_plain(mesh) else inspect_mesh(mesh).sign_problems
        return self._problems

    def lost_digits(self, mesh: TriangleMesh) -> list[str]:
        """Sentences about what float32 does not hold of the mesh."""
        if self._lost_digits is None:
            self._lost_digits = lost_digits(mesh)
        return self._lost_digits

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


def _is_closed(mesh: TriangleMesh) -> bool:
    from sdm.topology.boundary_edges import boundary_edges

    return boundary_edges(mesh.vertices, mesh.faces).shape[0] == 0


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
    from sdm.topology.component_volumes import every_component_encloses
    from sdm.topology.face_pairing import pairing_of

    pairing = pairing_of(mesh.faces, mesh.vertices.shape[0])
    edges = boundary_edges(mesh.vertices, mesh.faces)
    # They are sorted.
    if edges.shape[0] and bool((edges[1:] == edges[:-1]).all(1).any()):
        return False
    around = pairing.neighbours
    if pairing.unmatched.shape[0]:
        around = torch.from_numpy(_joined(*mesh.numpy(), around.cpu().numpy())).to(mesh.device)
    # A closed component has to enclose something, an open one not less than nothing.
    least = -LEAST_VOLUME if edges.shape[0] else LEAST_VOLUME
    return every_component_encloses(least, mesh.vertices, mesh.faces, around)


def _joined(vertices: np.ndarray, faces: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Neighbours (F,4) with those at edges of one face each that lie in the same place."""
    face, k = np.nonzero(around[:, :3] < 0)
    ends = np.stack([faces[face, k], faces[face, (k + 1) % 3]])
    place = first_at_position(vertices[ends.ravel()]).reshape(2, -1)
    low, high = place.min(0), place.max(0)
    key = np.where(low == high, -1, low * place.size + high)
    order = np.argsort(key, kind="stable")
    same = (key[order[1:]] == key[order[:-1]]) & (key[order[1:]] >= 0)
    one, other = order[:-1][same], order[1:][same]
    around = around.copy()
    around[face[one], k[one]] = 3 * face[other]
    return around
