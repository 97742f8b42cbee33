"""The acceleration structure of a batch of meshes: a bounding volume hierarchy and what is searched with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from sdm.core.mesh import MOST_TRIANGLES
from sdm.engine.structure.sizes import VISITING, WITH_DIPOLES, MeshKind, Sizes, closed_by_faces, kind_of
from sdm.errors import MeshError
from sdm.kernels.bvh import tree, triangle_frames
from sdm.kernels.bvh.build import build_tree
from sdm.kernels.culling import normal_cones, voronoi_features
from sdm.kernels.launch import set_array
from sdm.kernels.winding import cap_tree, dipole_tree, winding_number
from sdm.kernels.winding.boundary_term import gather_boundary
from sdm.runtime.graphs.branches import FRAMES, MOMENTS, Join, fork, kernels_beside, nothing
from sdm.runtime.torch_warp import ALIGNMENT, array_at, as_warp, on_current_stream, repeated_row, workspace
from sdm.topology.boundary_edges import MOST_ON_HOST, MeshTopology, boundary_edges
from sdm.topology.cap_triangles import cap_triangles, turned_faces
from sdm.topology.device_joining import boundary_on_device
from sdm.topology.face_pairing import pairing_of


class Array(NamedTuple):
    """One array of the structure."""

    struct: str  # which of the kernels' structs it belongs to, see `KernelView`
    name: str  # and its name there
    dtype: Any  # Warp type of an element
    length: Callable[[Sizes], int]  # number of elements, the same for each mesh


ARRAYS = (
    Array("tree", "corners", wp.vec3, lambda n: 4 * n.slots),
    Array("tree", "lattice", wp.vec2i, lambda n: 3 * n.slots),
    Array("tree", "face", wp.int32, lambda n: n.slots),
    Array("tree", "boxes", wp.float32, lambda n: n.nodes * tree.BOX_FLOATS),
    Array("tree", "frame", wp.float64, lambda n: n.meshes * tree.FRAME_SIZE),
    Array("triangles", "frames", wp.float32, lambda n: n.slots * triangle_frames.FRAME_FLOATS),
    Array("features", "rows", wp.float32, lambda n: n.slots * voronoi_features.FEATURE_FLOATS),
    Array("features", "inverses", wp.float64, lambda n: n.slots * voronoi_features.INVERSES),
    Array("features", "balls", wp.float32, lambda n: 4 * n.slots),
    Array("cones", "triangles", wp.float32, lambda n: 4 * n.slots),
    Array("cones", "nodes", wp.float32, lambda n: 4 * n.nodes),
    Array("boundary", "ends", wp.vec3, lambda n: 2 * n.visited_edges),
    Array("boundary", "lattice", wp.vec2i, lambda n: 2 * n.visited_edges),
    Array("caps tree", "corners", wp.vec3, lambda n: 4 * n.all_caps),
    Array("caps tree", "lattice", wp.vec2i, lambda n: 3 * n.all_caps),
    Array("caps tree", "face", wp.int32, lambda n: n.all_caps),
    Array("caps tree", "boxes", wp.float32, lambda n: n.cap_nodes * tree.BOX_FLOATS),
    Array("caps", "moments", wp.float32, lambda n: n.cap_nodes * cap_tree.MOMENTS_SIZE),
    Array("winding", "moments", wp.float32, lambda n: n.dipole_nodes * dipole_tree.MOMENTS_SIZE),
)


class KernelView(NamedTuple):
    """The structure as kernels take it. Nobody may write into the structs."""

    tree: Any  # `sdm.kernels.bvh.tree.Tree`
    winding: Any  # `sdm.kernels.winding.winding_number.Winding`
    frames: wp.array  # the triangles' frames
    features: Any  # `sdm.kernels.culling.voronoi_features.Features`
    cones: Any  # `sdm.kernels.culling.normal_cones.Cones`


@dataclass(frozen=True, eq=False)
class AccelerationStructure:
    """The arrays of a batch of meshes that have the same number of faces, in torch's memory.

    Args:
        sizes: How many there are of everything.
        memory: The tensor that all arrays are parts of, or one tensor for each of `ARRAYS`, in that order. They must
            live until the last kernel that uses them is queued.
        view: The arrays for kernels.
        pieces: If they are parts of one tensor, the bytes of each, followed by those that nobody uses.
    """

    sizes: Sizes
    memory: tuple[Tensor, ...]
    view: KernelView
    pieces: tuple[int, ...] = ()

    @classmethod
    def in_block(cls, sizes: Sizes, device: torch.device, block: Tensor | None = None) -> AccelerationStructure:
        """The structure whose arrays are parts of one block of bytes, by default a new one without content."""
        length, _, pieces = layout(sizes)
        if block is None:
            block = torch.empty(length, dtype=torch.uint8, device=device)
        return cls(sizes, (block,), _view_of_block(sizes, block.data_ptr(), block.device), pieces)

    @classmethod
    def from_tensors(cls, tensors: Sequence[Tensor], kind: int, meshes: int) -> AccelerationStructure:
        """The structure that was handed to an operator as `tensors` and its kind."""
        spans, count = [], {}
        for array, tensor in zip(ARRAYS, tensors, strict=True):
            length = tensor.shape[0] // wp.types.type_size_in_bytes(array.dtype)
            spans.append((tensor.data_ptr(), length))
            count[array.struct, array.name] = length
        faces, edges = count["tree", "face"] // meshes, count["boundary", "lattice"] // (2 * meshes)
        sizes = Sizes(meshes, faces, edges, MeshKind(kind))
        return cls(sizes, tuple(tensors), _view(sizes, spans, tensors[0].device))

    @property
    def tensors(self) -> list[Tensor]:
        """One tensor of bytes for each of `ARRAYS`, over the same memory."""
        return list(self.memory[0].split(self.pieces)[::2] if self.pieces else self.memory)

    @property
    def kind(self) -> MeshKind:
        """Method by which winding numbers are found."""
        return self.sizes.kind

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(tensor.nbytes for tensor in self.memory)

    @property
    def device(self) -> torch.device:
        """Device of the arrays."""
        return self.memory[0].device

    def of_mesh(self, mesh: int) -> AccelerationStructure:
        """The structure of one mesh of the batch, over the same memory."""
        return self.from_tensors(tensors_of_mesh(self.tensors, mesh, self.sizes.meshes), self.kind, 1)


def tensors_of_mesh(tensors: list[Tensor], mesh: int, meshes: int) -> list[Tensor]:
    """The tensors of one mesh of a batch: slices, no copies."""
    return [t[mesh * (t.shape[0] // meshes) : (mesh + 1) * (t.shape[0] // meshes)] for t in tensors]


@lru_cache(maxsize=256)
def layout(sizes: Sizes) -> tuple[int, tuple[tuple[int, int], ...], tuple[int, ...]]:
    """Bytes of all arrays together, of each its offset and number of elements, and the bytes and padding of each."""
    end, spans, pieces = 0, [], []
    for array in ARRAYS:
        length = array.length(sizes)
        nbytes = length * wp.types.type_size_in_bytes(array.dtype)
        spans.append((end, length))
        pieces += [nbytes, -nbytes % ALIGNMENT]
        end += nbytes + -nbytes % ALIGNMENT
    return end, tuple(spans), tuple(pieces)


@lru_cache(maxsize=64)
def _view_of_block(sizes: Sizes, base: int, device: torch.device) -> KernelView:
    # Torch's allocator gives the same few addresses again and again, and views own nothing.
    return _view(sizes, [(base + offset, length) for offset, length in layout(sizes)[1]], device)


def _view(sizes: Sizes, spans: Sequence[tuple[int, int]], device: torch.device) -> KernelView:
    """The kernels' view of arrays, each at an address and of a number of elements."""
    winding = winding_number.Winding()
    structs = {
        "tree": tree.Tree(),
        "features": voronoi_features.Features(),
        "cones": normal_cones.Cones(),
        "boundary": winding.boundary,
        "caps": winding.caps,
        "caps tree": winding.caps.tree,
        "winding": winding,
    }
    frames: Any = None
    for array, (address, length) in zip(ARRAYS, spans, strict=True):
        made = array_at(address, (length,), array.dtype, device)
        if array.struct == "triangles":
            frames = made
        else:
            set_array(structs[array.struct], array.name, made)
        if array.name == "frame":
            # Caps are in the meshes' own frame.
            set_array(winding.caps.tree, array.name, made)
    structs["tree"].count, structs["tree"].depth = sizes.faces, tree.depth_for(sizes.faces)
    winding.boundary.count = sizes.edges if sizes.kind in VISITING else 0
    winding.caps.tree.count = sizes.caps
    winding.caps.tree.depth = cap_tree.depth_of_caps(sizes.caps)
    winding.caps.are_faces = int(closed_by_faces(sizes.kind, sizes.edges, sizes.faces))
    winding.kind = int(sizes.kind)
    return KernelView(structs["tree"], winding, frames, structs["features"], structs["cones"])


def build(
    vertices: Tensor, faces: Tensor, edges: Tensor | None = None, *, tree_alone: bool = False, for_maps: bool = False
) -> AccelerationStructure:
    """Build the structure of a batch of meshes on their device.

    Args:
        vertices: (B,V,3) float32.
        faces: (F,3) int32, shared.
        edges: (E,2) int32 boundary edges, found here if None.
        tree_alone: Leave frames, features and cones without content, see `search_needs_tree_alone`.
        for_maps: See `fill_boundary`.

    Raises:
        MeshError: More triangles in all than the kernels can count.
    """
    vertices, faces = vertices.contiguous(), faces.contiguous()
    topology = topology_for(vertices, faces, edges)
    return queue_build(vertices, faces, topology, tree_alone=tree_alone, for_maps=for_maps)


def topology_for(vertices: Tensor, faces: Tensor, edges: Tensor | None = None) -> MeshTopology:
    """The topology of a batch of meshes, with the caps of its holes if `queue_build` looks at them.

    Raises:
        MeshError: More triangles in all than the kernels can count.
    """
    meshes = vertices.shape[:-2].numel()
    if meshes * faces.shape[0] > MOST_TRIANGLES:
        raise MeshError(
            f"{meshes:,} meshes of {faces.shape[0]:,} triangles are more than the {MOST_TRIANGLES:,} that "
            "one call can take; use smaller batches, or a coarser mesh"
        )
    pairing = pairing_of(faces, vertices.shape[-2])
    if edges is None and pairing.unmatched.shape[0] > MOST_ON_HOST and meshes == 1:
        edges = boundary_on_device(pairing, vertices.detach().reshape(-1, 3).contiguous())
    if edges is None:
        edges = boundary_edges(vertices, faces) if pairing.unmatched.shape[0] else pairing.unmatched[:, :2]
    kind, caps = kind_of(edges.shape[0], faces.shape[0]), edges
    if kind in VISITING:
        caps = turned_faces(faces) if closed_by_faces(kind, len(edges), len(faces)) else cap_triangles(edges)
    return MeshTopology(pairing.neighbours, edges, caps)


def queue_build(
    vertices: Tensor,
    faces: Tensor,
    topology: MeshTopology,
    join: Join | None = None,
    *,
    tree_alone: bool = False,
    for_maps: bool = False,
) -> AccelerationStructure:
    """Queue the kernels of `build`, and do nothing else: `vertices` and `faces` are contiguous.

    If the topology is found on a branch of the graph that is being recorded, `join` is called before it is read.
    `for_maps`: see `fill_boundary`.
    """
    meshes, count, edges = vertices.shape[0], faces.shape[0], topology.boundary.shape[0]
    sizes = Sizes(meshes, count, edges, kind_of(edges, count))
    structure = AccelerationStructure.in_block(sizes, vertices.device)
    with on_current_stream(vertices, vertices, faces, *topology):
        bounds = torch.empty(6 * meshes, dtype=torch.float32, device=vertices.device)
        room = as_warp(bounds, wp.float32)
        fill_surface(structure.view, vertices, faces, topology.neighbours, room, join, tree_alone=tree_alone)
        fill_boundary(structure, vertices, topology, room, for_maps=for_maps)()
    return structure


def fill_surface(
    view: KernelView,
    vertices: Tensor,
    faces: Tensor,
    neighbours: Tensor,
    bounds: wp.array,
    join: Join | None = None,
    *,
    tree_alone: bool = False,
    gathered: Join | None = None,
    unjoined: list[Join] | None = None,
    features_later: bool = False,
    fillers: bool = False,
    is_bounded: bool = False,
    counts: wp.array | None = None,
) -> None:
    """Queue the kernels that need no boundary, and fill each mesh's `bounds`, as `build_tree` does, with its options.

    To `unjoined` is added what has to be called before cones are read, and before features are, if that is to be later;
    then only the branches that make them wait for the neighbours. With `features_later` these are queued then.
    """
    count, empty = view.tree.face.shape[0], workspace(vertices.device)
    corners, triples = as_warp(vertices, wp.vec3), as_warp(faces, wp.int32)
    if view.tree.meshes:  # that differ: all vertices in one row, which is that of every mesh
        corners = repeated_row(corners, view.tree.meshes)
    normals = empty(4 * count, wp.float32)
    keys, slots = empty(2 * count, wp.int64), empty(2 * count, wp.int32)
    shared, joins = as_warp(neighbours, wp.int32), []

    def beside_boxes() -> None:
        """Launches that need the triangles in their order, and no boxes: none of them fills a GPU."""
        with kernels_beside(vertices, FRAMES) as join_frames:
            triangle_frames.make_frames(view.tree, view.frames)
        with kernels_beside(vertices, after=join) as join_cones:
            normal_cones.make_cones(view.tree, normals, triples, shared, view.cones)
        features = view.tree, corners, normals, triples, shared, view.features
        joins.extend((join_frames, join_cones))
        if not features_later:
            with kernels_beside(vertices, FRAMES, join) as join_features:
                voronoi_features.make_features(*features)
            joins.append(join_features)
        else:
            joins.append(partial(_make_features, features, vertices, join, fork(vertices.device), (empty, faces)))
        if gathered is not None:
            gathered()

    hook = gathered if tree_alone else beside_boxes
    options: Any = {"fillers": fillers, "is_bounded": is_bounded, "counts": counts}
    build_tree(view.tree, corners, triples, bounds, keys, slots, normals, hook, **options)
    if tree_alone:
        if join is not None:
            join()
        return
    join_frames, *others = joins
    join_frames()
    if unjoined is None:
        for each in others:
            each()
    else:
        # Branches read normals, whose memory is kept until then.
        unjoined += [*others, lambda _kept=empty: None]


def _make_features(features: Any, vertices: Tensor, join: Join | None, since: Join, _kept: object) -> None:
    """Queue the kernel of features beside what follows `since`, and wait for it."""
    with kernels_beside(vertices, FRAMES, join, since) as made:
        voronoi_features.make_features(*features)
    made()


def fill_boundary(
    structure: AccelerationStructure, vertices: Tensor, topology: MeshTopology, bounds: wp.array, for_maps: bool = False
) -> Join:
    """Queue the kernels that depend on a boundary, after those of `fill_surface`.

    What it gives is to be called before the caps' moments are read.
    `for_maps`: the structure is for maps alone, so dipoles of a mesh with caps are left out: a launch a level.
    """
    view, meshes, kind = structure.view, structure.sizes.meshes, structure.kind
    join: Join = nothing
    if kind in VISITING:
        empty, corners = workspace(vertices.device), as_warp(vertices, wp.vec3)
        gather_boundary(view.winding.boundary, view.tree, corners, as_warp(topology.boundary, wp.int32))
        room = 2 * structure.sizes.all_caps
        caps, keys, slots = as_warp(topology.caps, wp.int32), empty(room, wp.int64), empty(room, wp.int32)
        beside = partial(kernels_beside, vertices, MOMENTS)
        join = cap_tree.build_caps(view.winding.caps, corners, caps, bounds, keys, slots, beside=beside)
    if kind in WITH_DIPOLES and not (for_maps and kind in VISITING):
        dipole_tree.build_moments(view.tree, view.winding.moments, meshes)
    return join
