"""The acceleration structures of meshes that differ, built together: one sort of all triangles, the number of the mesh
in front of the place on the curve.

The arrays are those of `sdm.engine.acceleration`, one mesh behind the other. A table says where each begins. A mesh's
part of them is bit for bit its structure by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple, cast

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import (
    ARRAYS,
    AccelerationStructure,
    KernelView,
    MeshKind,
    Sizes,
    fill_boundary,
    fill_surface,
    kind_of,
)
from sdm.engine.structure.sizes import VISITING, closed_by_faces
from sdm.errors import MeshError
from sdm.kernels.bvh.tree import COUNT, LEFT_OUT, PART_SIZE, coarser, depth_for
from sdm.kernels.launch import set_array
from sdm.runtime.torch_warp import as_warp, on_current_stream, to_device
from sdm.topology.boundary_edges import MeshTopology
from sdm.topology.cap_triangles import remember_caps, turned_faces
from sdm.topology.face_pairing import Pairing, PairingUnderWay, is_known, remember
from sdm.topology.joint_boundaries import JointBoundaries, caps_of, joint_boundaries

# Places in the rows of `RaggedBuild`, behind those of `sdm.kernels.bvh.tree`: a mesh's first vertex, and its vertices.
FIRST_VERTEX, VERTICES = 5, 6
# What only an open mesh has.
OF_BOUNDARY = ("boundary", "caps tree", "caps", "winding")


class JoinedSizes(NamedTuple):
    """Sizes that the shapes of all arrays follow from, as `Sizes` of meshes that differ: without boundaries."""

    meshes: int
    faces: int  # of the largest mesh
    slots: int  # triangles of all
    nodes: int  # of all hierarchies

    # Of no mesh the boundary is among the arrays.
    edges = visited_edges = caps = all_caps = cap_nodes = dipole_nodes = 0
    kind = MeshKind.CLOSED


@dataclass(frozen=True, eq=False)
class RaggedStructure:
    """The structures of meshes that differ.

    Args:
        meshes: They themselves, on their device.
        rows: (meshes, 7) of each where it begins, see `RaggedBuild`.
        memory: The tensor that all arrays are parts of.
        parts: Where each mesh begins, see `sdm.kernels.bvh.tree`.
        view: The arrays for kernels: of the winding numbers, as if all meshes were closed.
        bounds: (6 * meshes) float32, each mesh's lowest and highest coordinates.
        vertices: (V,3) float32, of all meshes in a row.
        boundaries: Those of the meshes; None if all are closed.
        neighbours: (F,4) of all faces, see `sdm.kernels.topology.edge_pairing`.
    """

    meshes: list[TriangleMesh]
    sizes: JoinedSizes
    rows: list[list[int]]
    memory: Tensor
    parts: Tensor
    view: KernelView
    bounds: Tensor
    vertices: Tensor
    boundaries: JointBoundaries | None
    neighbours: Tensor
    _boundary: dict[int, Tensor] = field(default_factory=dict)

    @cached_property
    def kinds(self) -> dict[int, MeshKind]:
        """The kind of each open mesh, by its place."""
        counts = self.boundaries.counts if self.boundaries is not None else ()
        return {i: kind_of(count, self.rows[i][COUNT]) for i, count in enumerate(counts) if count}

    def neighbours_of(self, mesh: int) -> Tensor:
        """The neighbours (F,4) of one mesh's faces, by their own numbers."""
        return _own_neighbours(self.neighbours, *self.rows[mesh][: COUNT + 1])

    def edges_of(self, mesh: int) -> Tensor:
        """The boundary edges (E,2) of one mesh, by the numbers of their vertices among all."""
        if self.boundaries is None:
            return self.meshes[mesh].faces.new_empty((0, 2))
        begin, end = self.boundaries.begins[mesh : mesh + 2]
        return self.boundaries.edges[begin:end]

    def boundary_of(self, mesh: int) -> Tensor:
        """The boundary edges (E,2) of one mesh."""
        found = self._boundary.get(mesh)
        if found is None:
            found = self._boundary[mesh] = self.edges_of(mesh) - self.rows[mesh][FIRST_VERTEX]
        return found

    def topology_of(self, mesh: int) -> MeshTopology:
        """The topology of one mesh, with the caps of its holes if maps look at them."""
        edges = caps = self.boundary_of(mesh)
        if mesh in self._caps:
            caps = self._caps[mesh] - self.rows[mesh][FIRST_VERTEX]
            remember_caps(edges, caps)
        elif self.kinds.get(mesh) in VISITING:
            caps = turned_faces(self.meshes[mesh].faces)
        return MeshTopology(self.neighbours_of(mesh), edges, caps)

    @cached_property
    def _caps(self) -> dict[int, Tensor]:
        """Caps (E,3) by the numbers of their vertices among all, of the meshes that are closed by such."""
        found = self.boundaries
        if found is None:
            return {}
        counts = found.counts
        some = [
            i
            for i, kind in self.kinds.items()
            if kind in VISITING and not closed_by_faces(kind, counts[i], self.rows[i][COUNT])
        ]
        caps = caps_of(found.of_some(some), self.vertices.shape[0])
        return dict(zip(some, caps.split([counts[i] for i in some]), strict=True))

    def remember_pairing(self, mesh: int) -> None:
        """Let others know what the faces of one mesh say, who would find it anew."""
        faces, count = self.meshes[mesh].faces, self.meshes[mesh].vertices.shape[0]
        if mesh not in self.kinds and not is_known(faces, count):
            remember(faces, count, Pairing(faces.new_empty((0, 3)), self.neighbours_of(mesh)))

    def of_mesh(self, mesh: int, *, for_maps: bool = False) -> AccelerationStructure:
        """The structure of one mesh, over the same memory; what only an open mesh has is made here.

        `for_maps`: see `fill_boundary`.
        """
        first_slot, count, _, first_node, *_ = self.rows[mesh]
        begin = JoinedSizes(mesh, 0, first_slot, first_node)
        topology = self.topology_of(mesh) if mesh in self.kinds else None
        edges = 0 if topology is None else topology.boundary.shape[0]
        sizes, tensors = Sizes(1, count, edges, kind_of(edges, count)), []
        for array, whole in zip(ARRAYS, self._tensors, strict=True):
            step, length = wp.types.type_size_in_bytes(array.dtype), array.length(sizes)
            if array.struct in OF_BOUNDARY:
                tensors.append(torch.empty(step * length, dtype=torch.uint8, device=self.memory.device))
            else:
                first = step * array.length(cast(Sizes, begin))
                tensors.append(whole[first : first + step * length])
        structure = AccelerationStructure.from_tensors(tensors, sizes.kind, 1)
        if topology is not None:
            vertices = self.meshes[mesh].vertices.detach()[None]
            with on_current_stream(vertices, vertices, *tensors, self.bounds, *topology):
                bounds = as_warp(self.bounds[6 * mesh :][:6], wp.float32)
                fill_boundary(structure, vertices, topology, bounds, for_maps=for_maps)()
        return structure

    @property
    def frames(self) -> Tensor:
        """(meshes, FRAME_SIZE) float64, see `sdm.kernels.bvh.tree.Tree`."""
        place = next(i for i, array in enumerate(ARRAYS) if (array.struct, array.name) == ("tree", "frame"))
        return self._tensors[place].view(torch.float64).view(len(self.meshes), -1)

    @cached_property
    def _tensors(self) -> list[Tensor]:
        return AccelerationStructure.in_block(cast(Sizes, self.sizes), self.memory.device, self.memory).tensors


class RaggedBuild:
    """A build whose kernels are queued, while what the faces say about boundaries is on its way to the host.

    Args:
        meshes: Any triangles, on one device.
        tree_alone: Leave frames, features and cones without content, see `sdm.engine.points`.

    Attributes:
        view: The arrays for kernels, as if all meshes were closed.
        memory: The tensors that they are parts of.
    """

    def __init__(self, meshes: Sequence[TriangleMesh], *, tree_alone: bool = False) -> None:
        device, self._meshes = meshes[0].device, list(meshes)
        counts = [mesh.faces.shape[0] for mesh in meshes]
        vertex_counts = [mesh.vertices.shape[0] for mesh in meshes]
        depths = [depth_for(count) for count in counts]
        slots, nodes = [0, *accumulate(counts)], [0, *accumulate([2 << depth for depth in depths])]
        first_vertices = [0, *accumulate(vertex_counts)]
        first_vertex, left_out = first_vertices[-1], [0] * len(counts)
        columns = slots[:-1], counts, depths, nodes[:-1], left_out, first_vertices[:-1], vertex_counts
        rows = np.array(columns, np.int32).T.copy()
        self._rows: list[list[int]] = rows.tolist()
        self._sizes = sizes = JoinedSizes(len(counts), max(counts), slots[-1], nodes[-1])
        self._table = table = to_device(torch.from_numpy(rows), device)
        with torch.no_grad():
            self._vertices = vertices = torch.cat([mesh.vertices for mesh in meshes])
        faces, self._out_of_range = _joined_faces(meshes, table, sizes.slots)
        self._parts = table[:, :PART_SIZE].contiguous()
        # Typed for meshes that share faces, but only these attributes are looked at.
        empty = AccelerationStructure.in_block(cast(Sizes, sizes), device)
        tree = coarser(empty.view.tree, 0)
        set_array(tree, "parts", as_warp(self._parts.view(-1), wp.int32))
        tree.meshes = len(meshes)
        self.view = empty.view._replace(tree=tree)
        self.memory = empty.memory[0], self._parts
        self._bounds = torch.empty(6 * len(meshes), dtype=torch.float32, device=device)
        self._pairing = PairingUnderWay(faces, first_vertex)
        with on_current_stream(vertices, vertices, faces, self._parts):
            # The kernels do not wait for what the faces say about the boundary.
            bounds = as_warp(self._bounds, wp.float32)
            around = self._pairing.neighbours
            fill_surface(self.view, vertices[None], faces, around, bounds, tree_alone=tree_alone)

    def leave_out(self, levels: Tensor | None) -> None:
        """Have candidate lists do without so many last levels of each tree, if not None: (meshes,), on the device."""
        if levels is not None:
            self._parts[:, LEFT_OUT] = levels

    def finish(self, numbers: Sequence[int], *, remember: bool = False) -> RaggedStructure:
        """The structures, once the device has found the boundaries.

        Args:
            numbers: The meshes' numbers, as errors call them.
            remember: Let others know what the faces of open meshes say. On a GPU nobody asks, and each would wait.

        Raises:
            MeshError: A face index out of range.
        """
        pairing = self._pairing.finish()
        # This was queued before the pairing was.
        if bool(self._out_of_range):
            _refuse_out_of_range(self._meshes, numbers)
        boundaries, vertices = None, self._vertices
        if pairing.unmatched.shape[0]:
            counts = self._table[:, VERTICES].contiguous()
            boundaries = joint_boundaries(pairing.unmatched, self._pairing.found, vertices, counts)
            if remember and not vertices.is_cuda:
                _remember_open(self._meshes, self._rows, pairing)
        found = self._bounds, vertices, boundaries, pairing.neighbours
        return RaggedStructure(self._meshes, self._sizes, self._rows, *self.memory, self.view, *found)


def _joined_faces(meshes: Sequence[TriangleMesh], table: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """All faces (F,3) by the number of their vertices among all, and on the host whether any is out of range."""
    given = torch.cat([mesh.faces for mesh in meshes])
    # Of each face its mesh's first vertex, and how many it has.
    first, length = torch.repeat_interleave(table[:, 5:], table[:, 1], dim=0, output_size=count).split(1, dim=1)
    within = given.clamp(min=0).minimum(length - 1)
    wrong = (within != given).any()
    if given.is_cuda:
        wrong = torch.empty((), dtype=torch.bool, pin_memory=True).copy_(wrong, non_blocking=True)
    return within.add_(first), wrong


def _refuse_out_of_range(meshes: Sequence[TriangleMesh], numbers: Sequence[int]) -> None:
    for mesh, number in zip(meshes, numbers, strict=True):
        low, high = (int(bound) for bound in mesh.faces.aminmax())
        count = mesh.vertices.shape[0]
        if low < 0 or high >= count:
            raise MeshError(
                f"mesh {number}: a face uses vertex {low if low < 0 else high}, but the {count} vertices are numbered "
                f"0 to {count - 1}"
            )


def _own_neighbours(neighbours: Tensor, first: int, count: int) -> Tensor:
    """Rows of `count` faces from `first` on, with edges counted from there."""
    around = neighbours[first : first + count].clone()
    edges = around[:, :3]
    edges.copy_(torch.where(edges < 0, edges, edges - 3 * first))
    return around


def _remember_open(meshes: Sequence[TriangleMesh], rows: Sequence[list[int]], pairing: Pairing) -> None:
    """Remember what the faces of each mesh with unmatched edges say by themselves."""
    firsts = torch.tensor([row[FIRST_VERTEX] for row in rows], dtype=torch.int32, device="cpu")
    owners = torch.searchsorted(firsts, pairing.unmatched[:, 0].contiguous(), right=True) - 1
    for mesh in owners.unique().tolist():
        first_face, count, *_ = rows[mesh]
        unmatched = pairing.unmatched[owners == mesh]
        unmatched[:, :2] -= rows[mesh][FIRST_VERTEX]
        around = _own_neighbours(pairing.neighbours, first_face, count)
        remember(meshes[mesh].faces, rows[mesh][VERTICES], Pairing(unmatched, around))
