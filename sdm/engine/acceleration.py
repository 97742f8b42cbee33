"""The acceleration structure as torch tensors, so that torch's allocator and streams look after its memory."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.mesh import MOST_TRIANGLES
from sdm.errors import MeshError
from sdm.kernels.bvh import tree, triangle_frames
from sdm.kernels.bvh.build import build_tree
from sdm.kernels.culling import normal_cones, voronoi_features
from sdm.kernels.winding import dipole_tree
from sdm.kernels.winding.boundary_term import Boundary, gather_boundary
from sdm.kernels.winding.winding_number import CLOSED, MANY, OPEN, SOUP, Winding
from sdm.runtime.graph_branches import Join, kernels_beside
from sdm.runtime.torch_warp import ALIGNMENT, array_at, as_warp, on_current_stream, scratch_on
from sdm.topology.boundary_edges import boundary_edges, loops, neighbours

# Above this many boundary edges the tree of dipoles costs less than visiting every edge for one point; above the second
# number also than visiting them for a whole block of voxels.
MOST_BOUNDARY_EDGES = 1024
MOST_FOR_BLOCKS = 8192
# Only of a surface with holes, though: of loose triangles, whose edges are all boundary, no block is far from any.
FEWEST_FACES_AN_EDGE = 16


def kind_of(edges: Tensor, faces: Tensor) -> int:
    """How the sign of a mesh with these boundary edges and faces is found."""
    count = edges.shape[0]
    if count == 0:
        return CLOSED
    if count <= MOST_BOUNDARY_EDGES:
        return OPEN
    few = count <= MOST_FOR_BLOCKS and count * FEWEST_FACES_AN_EDGE <= faces.shape[0]
    return MANY if few else SOUP


def build(vertices: Tensor, faces: Tensor, edges: Tensor | None = None) -> tuple[list[Tensor], int]:
    """Build the hierarchy of a batch of meshes on their device.

    Args:
        vertices: (B,V,3) float32.
        faces: (F,3) int32, shared.
        edges: (E,2) int32 boundary edges, found here if None.

    Returns:
        The tensors that `unpack` understands, and the kind of mesh.

    Raises:
        MeshError: More triangles in all than the kernels can count.
    """
    check_count(vertices, faces)
    vertices, faces = vertices.contiguous(), faces.contiguous()
    return build_known(vertices, faces, *surroundings(vertices, faces, edges))


def check_count(vertices: Tensor, faces: Tensor) -> None:
    """Refuse vertices (B,V,3) and faces with more triangles in all than the kernels can count.

    Raises:
        MeshError: There are.
    """
    if vertices.shape[0] * faces.shape[0] > MOST_TRIANGLES:
        raise MeshError(
            f"{vertices.shape[0]:,} meshes of {faces.shape[0]:,} triangles are more than the {MOST_TRIANGLES:,} that "
            "one call can take; use smaller batches, or a coarser mesh"
        )


def surroundings(vertices: Tensor, faces: Tensor, edges: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """What `build_known` wants to know about faces: neighbours, boundary edges and, of an open mesh, their loops."""
    if edges is None:
        edges = boundary_edges(vertices, faces)
    around = loops(edges) if kind_of(edges, faces) in (OPEN, MANY) else edges
    return neighbours(faces, vertices.shape[-2]), edges, around


def build_known(
    vertices: Tensor, faces: Tensor, shared: Tensor, edges: Tensor, around: Tensor, join: Join | None = None
) -> tuple[list[Tensor], int]:
    """`build` of contiguous tensors whose `surroundings` are known: queues kernels, and does nothing else.

    If they are found `beside` this, `join` is called before they are looked at.
    """
    kind = kind_of(edges, faces)
    meshes, count = vertices.shape[0], faces.shape[0]
    tensors = _allocate(list(_sizes(meshes, count, edges.shape[0], kind).values()), vertices.device)
    empty = scratch_on(vertices.device)
    with on_current_stream(vertices, vertices, faces, edges, shared, around):
        hierarchy, winding, local, pieces, facing = unpack(tensors, kind, meshes)
        corners = as_warp(vertices, wp.vec3)
        normals = empty(4 * meshes * count, wp.float32)
        build_tree(
            hierarchy,
            corners,
            as_warp(faces, wp.int32),
            empty(6 * meshes, wp.float32),
            empty(2 * meshes * count, wp.int64),
            empty(2 * meshes * count, wp.int32),
            normals,
        )
        if join is not None:
            join()
        around_faces = as_warp(faces, wp.int32), as_warp(shared, wp.int32)
        # None of these fills a GPU by itself.
        with kernels_beside(vertices) as join_parts:
            voronoi_features.make_features(hierarchy, corners, normals, *around_faces, pieces)
        triangle_frames.make_frames(hierarchy, local)
        normal_cones.make_cones(hierarchy, normals, *around_faces, facing)
        join_parts()
        if kind in (OPEN, MANY):
            gather_boundary(winding.boundary, hierarchy, corners, as_warp(edges, wp.int32), as_warp(around, wp.int32))
        if kind in (MANY, SOUP):
            dipole_tree.build_moments(hierarchy, winding.moments, meshes)
    return tensors, kind


def _sizes(meshes: int, count: int, edges: int, kind: int) -> dict[str, int]:
    """Bytes of each array of a hierarchy, in the order of its tensors: what `_views` looks at."""
    slots = meshes * count
    arrays = tree.sizes(meshes, count)
    sizes = {name: math.prod(shape) * wp.types.type_size_in_bytes(dtype) for name, (shape, dtype) in arrays.items()}
    sizes["local"] = 4 * slots * triangle_frames.FRAME_FLOATS
    sizes["rows"] = 4 * slots * voronoi_features.FEATURE_FLOATS
    sizes["inverses"] = 8 * slots * voronoi_features.INVERSES
    sizes["balls"] = 4 * slots * 4
    sizes["cones"] = 4 * slots * 4
    sizes["node_cones"] = 4 * (meshes << (tree.depth_for(count) + 3))
    ends = 2 * meshes * edges if kind in (OPEN, MANY) else 0
    sizes["ends"] = 4 * ends * 3
    sizes["ends_lattice"] = 4 * ends * 2
    sizes["apexes"] = 4 * ends // 2 * 3
    nodes = arrays["boxes"][0][0] // tree.BOX_FLOATS if kind in (MANY, SOUP) else 0
    sizes["moments"] = 4 * nodes * dipole_tree.MOMENTS_SIZE
    return sizes


def _allocate(sizes: list[int], device: torch.device) -> list[Tensor]:
    """Bytes of these sizes, parts of one block: one allocation, and one to tell of the streams that read it."""
    padded = []
    for size in sizes:
        padded += [size, -size % ALIGNMENT]
    return list(torch.empty(sum(padded), dtype=torch.uint8, device=device).split(padded)[::2])


def unpack(tensors: list[Tensor], kind: int, meshes: int) -> tuple[Any, Any, wp.array, Any, Any]:
    """The kernels' view of what `build` made: a `Tree`, a `Winding`, the triangles' frames, `Features` and `Cones`.

    Nobody may write into what is returned, as the next call may return the same. As for `as_warp`, the tensors must
    live until the last kernel is queued.
    """
    at = tuple([(tensor.data_ptr(), tensor.shape[0]) for tensor in tensors])
    return _views(at, kind, meshes, tensors[0].device)


@lru_cache(maxsize=64)
def _views(
    at: tuple[tuple[int, int], ...], kind: int, meshes: int, device: torch.device
) -> tuple[Any, Any, wp.array, Any, Any]:
    # A function of addresses and sizes alone, as `array_at` is.
    left = iter(at)

    def array(dtype: Any) -> wp.array:
        address, size = next(left)
        return array_at(address, (size // wp.types.type_size_in_bytes(dtype),), dtype, device)

    hierarchy = tree.Tree()
    hierarchy.corners = array(wp.vec3)
    hierarchy.lattice = array(wp.vec2i)
    hierarchy.face = array(wp.int32)
    hierarchy.boxes = array(wp.float32)
    hierarchy.frame = array(wp.float64)
    hierarchy.count = hierarchy.face.shape[0] // meshes
    hierarchy.depth = tree.depth_for(hierarchy.count)
    local = array(wp.float32)
    pieces = voronoi_features.Features()
    pieces.rows = array(wp.float32)
    pieces.inverses = array(wp.float64)
    pieces.balls = array(wp.float32)
    facing = normal_cones.Cones()
    facing.triangles = array(wp.float32)
    facing.nodes = array(wp.float32)
    boundary = Boundary()
    boundary.ends = array(wp.vec3)
    boundary.lattice = array(wp.vec2i)
    boundary.apexes = array(wp.vec3)
    boundary.count = boundary.apexes.shape[0] // meshes
    winding = Winding()
    winding.boundary = boundary
    winding.moments = array(wp.float32)
    winding.kind = kind
    return hierarchy, winding, local, pieces, facing


def one_of(tensors: list[Tensor], mesh: int, meshes: int) -> list[Tensor]:
    """The hierarchy of one mesh of a batch: slices, no copies."""
    return [t[mesh * (t.shape[0] // meshes) : (mesh + 1) * (t.shape[0] // meshes)] for t in tensors]
