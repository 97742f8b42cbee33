"""Which edges bound a mesh, and which faces meet: what is left when every face's directed edges are added up."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.errors import MeshError
from sdm.kernels.topology import boundary_loops
from sdm.kernels.topology.edge_pairing import REMARKS, gather_ends, pair_edges
from sdm.runtime.torch_warp import as_warp, on_current_stream, version_of, workspace
from sdm.topology.joining import join_on_device, join_on_host, loops_on_host

# Up to this many edges left over, and this many in all meshes, are joined on the host: on a GPU each of the many small
# steps costs more than its work.
MOST_ON_HOST = 1 << 12
MOST_ON_HOST_IN_ALL = 1 << 19

# More edges left over are not compared with each other on the device; kinds of meshes that guesses are kept for.
MOST_GUESSED, MOST_KINDS = 1 << 10, 64

# What is known of tensors seen before: a stream asks about the same faces for every batch.
_seen: WeakIdKeyDictionary = WeakIdKeyDictionary()
_seen_loops: WeakIdKeyDictionary = WeakIdKeyDictionary()
_seen_host: WeakIdKeyDictionary = WeakIdKeyDictionary()
# By numbers of faces and vertices.
_last_open: OrderedDict[tuple[int, int], tuple[int, int]] = OrderedDict()


class MeshTopology(NamedTuple):
    """What a mesh's faces say about how they meet, all int32.

    Args:
        neighbours: (F,4), see `neighbours`.
        boundary: (E,2), see `boundary_edges`.
        loops: (E,), see `loops`; any tensor where nobody looks at it.
    """

    neighbours: Tensor
    boundary: Tensor
    loops: Tensor


@dataclass
class _Paired:
    """What faces say by themselves, wherever their vertices are.

    Args:
        left_over: (N,3) int32, the edges left over, as `sdm.kernels.topology.edge_pairing` gives them.
        shared: (F,4) int32, what `neighbours` returns.
        edges: (E,2) int32, the last boundary found.
        ready: When `shared` is written, if nobody has waited for that yet.
    """

    left_over: Tensor
    shared: Tensor
    edges: Tensor | None = None
    ready: torch.cuda.Event | None = None


def boundary_edges(vertices: Tensor, faces: Tensor) -> Tensor:
    """Directed boundary edges of a mesh, or of a batch of meshes that share faces.

    Args:
        vertices: (V,3) or (B,V,3) float32.
        faces: (F,3) int32.

    Returns:
        (E,2) int32 vertex indices, the surface on the left, sorted by the lower of both, then the higher. An edge
        whose directions do not cancel stands as often as they are left over. Empty means closed: the winding number
        is a whole number everywhere off the surface. Nobody may write into it: the next call may return the same.

    Vertices at exactly equal positions count as one, as in an STL file, if that is so in every mesh of the batch: as
    the first of those at which an edge is left over by its indices.

    Raises:
        MeshError: A face index out of range.
    """
    count = vertices.shape[-2]
    paired = _paired(faces, count)
    if paired.left_over.shape[0] == 0:
        return paired.left_over[:, :2]
    batch = vertices.detach().reshape(-1, count, 3)
    edges = paired.left_over.shape[0]
    if edges > MOST_ON_HOST or edges * batch.shape[0] > MOST_ON_HOST_IN_ALL:
        found = join_on_device(paired.left_over, batch)
        if paired.left_over.untyped_storage().nbytes() > paired.left_over.nbytes:
            # A part of a larger tensor would keep it all.
            paired.left_over = paired.left_over.clone()
        return found
    paired.left_over, found = _join_on_host(paired.left_over, batch)
    # As long as a mesh that moves keeps its boundary, so do those who remember something about it.
    if paired.edges is None or not np.array_equal(_on_host(paired.edges), found):
        paired.edges = torch.from_numpy(found).to(faces.device)
        _remembered(_seen_host, paired.edges, lambda: found)
    return paired.edges


def neighbours(faces: Tensor, count: int) -> Tensor:
    """For each face its neighbours, and which of its edges and corners it lists for them all.

    Args:
        faces: (F,3) int32.
        count: Number of vertices.

    Returns:
        (F,4) int32. Column k < 3: another face at the edge from corner k to the next, as 3 * face + edge, or -1. Column
        3: bits of what the face owns, 1, 2 and 4 for its corners, 8, 16 and 32 for its edges; the first face at an
        edge or a corner owns it. Of an edge from a vertex to itself nobody needs to know.

    Raises:
        MeshError: A face index out of range.
    """
    return _paired(faces, count).shared


def loops(edges: Tensor) -> Tensor:
    """For each boundary edge of (E,2), directed as `boundary_edges` gives them, the number of its loop: (E,) int32.

    Loops that meet at a vertex count as one; they are numbered by their lowest vertices. In a loop as many edges end
    at each vertex as begin there.
    """

    def find() -> Tensor:
        return torch.from_numpy(loops_on_host(_on_host(edges))).to(edges.device)

    return _remembered(_seen_loops, edges, find)


def is_known(faces: Tensor, count: int) -> bool:
    """Whether these faces were paired before, so that nothing has to wait for what they say by themselves."""
    known = _seen.get(faces)
    return known is not None and known[0] is not None and known[0] == _state(faces, count)


def leaves_none_over(faces: Tensor, count: int) -> bool:
    """Whether the mesh is closed wherever its vertices are, even if none of them count as one."""
    return _paired(faces, count).left_over.shape[0] == 0


def remember_closed(faces: Tensor, count: int, shared: Tensor) -> None:
    """Remember of faces that no edge of theirs is left over, and what `neighbours` returns.

    `shared` may still be under way on the current stream of its device: other streams wait for it when they ask.
    """
    ready = None
    if shared.is_cuda:
        ready = torch.cuda.Event()
        ready.record(torch.cuda.current_stream(shared.device))
    _seen[faces] = _state(faces, count), _Paired(faces.new_empty((0, 3)), shared, ready=ready)


def _paired(faces: Tensor, count: int) -> _Paired:
    found: _Paired = _remembered(_seen, faces, lambda: _pair_up(faces, count), count)
    ready = found.ready
    if ready is not None:
        with torch.cuda.device(found.shared.device):
            # Who captures has called before, so it is long there; an event of before must not be waited for then.
            if not torch.cuda.is_current_stream_capturing():
                torch.cuda.current_stream().wait_event(ready)
                if ready.query():
                    found.ready = None
    return found


def _pair_up(faces: Tensor, count: int) -> _Paired:
    """All that faces say, from one sort of all edges; waits for the device once."""
    remarks, left_over, shared = queue_pairing(faces.contiguous(), count)
    out_of_range, open_edges = remarks.tolist()
    if out_of_range:
        low, high = (int(bound) for bound in faces.aminmax())
        bad = low if low < 0 else high
        raise MeshError(f"a face uses vertex {bad}, but the {count} vertices are numbered 0 to {count - 1}")
    return _Paired(left_over[:open_edges] if open_edges else left_over.new_empty((0, 3)), shared)


def queue_pairing(faces: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """What `sdm.kernels.topology.edge_pairing` finds for contiguous faces, once the device gets there.

    Returns:
        The remarks (REMARKS,), the edges left over (3 * F, 3), of which the remarks tell how many, and (F,4) what
        `neighbours` returns: all int32. No index out of range does harm here.
    """
    total = faces.numel()
    first, remarks = torch.zeros(count + REMARKS, dtype=torch.int32, device=faces.device).split([count, REMARKS])
    left_over = torch.empty(total, 3, dtype=torch.int32, device=faces.device)
    shared = torch.empty(faces.shape[0], 4, dtype=torch.int32, device=faces.device)
    with on_current_stream(faces, faces):
        pair_edges(
            as_warp(faces, wp.int32),
            as_warp(first, wp.int32),
            as_warp(remarks, wp.int32),
            as_warp(left_over, wp.int32),
            as_warp(shared, wp.int32),
            workspace(faces.device),
        )
    return remarks, left_over, shared


def queue_joining(
    left_over: Tensor, found: Tensor, vertices: Tensor, rows: int, edges: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Queue the boundary loops of `queue_pairing`'s result, if so many edges are left over and bound the mesh.

    Returns:
        Remarks, zeros if that was right; else nothing is right. The boundary edges (E,2), and their loops' names (E,).
    """
    device = vertices.device
    remarks, flat = torch.zeros(boundary_loops.REMARKS + 2 * edges, dtype=torch.int32, device=device).split(
        [boundary_loops.REMARKS, 2 * edges]
    )
    around = torch.empty(edges, dtype=torch.int32, device=device)
    bounds = flat.view(edges, 2)
    with on_current_stream(vertices, vertices):
        boundary_loops.join_edges(
            as_warp(left_over[:rows], wp.int32),
            as_warp(found, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(bounds, wp.int32),
            as_warp(around, wp.int32),
            as_warp(remarks, wp.int32),
            workspace(device),
        )
    return remarks, bounds, around


def guess(faces: Tensor, count: int) -> tuple[int, int] | None:
    """How many edges were left over, and how many bounded the mesh, of the last open one with as many of everything.

    None if there was none, or the kernels of `queue_joining` are not made for so many.
    """
    return _last_open.get((faces.shape[0], count))


def remember_open(faces: Tensor, count: int, edges: Tensor) -> None:
    """Remember how many boundary `edges` faces had, if any, for the next `guess`."""
    rows = _paired(faces, count).left_over.shape[0]
    kind = faces.shape[0], count
    _last_open.pop(kind, None)
    # Loops that meet are not followed on the device.
    if 0 < rows <= MOST_GUESSED and 0 < edges.shape[0] == len(np.unique(_on_host(edges)[:, 0])):
        _last_open[kind] = rows, edges.shape[0]
        while len(_last_open) > MOST_KINDS:
            _last_open.popitem(last=False)


def _join_on_host(left_over: Tensor, vertices: Tensor) -> tuple[Tensor, np.ndarray]:
    """What is left over, in memory of its own, and the boundary edges; waits for the device once."""
    count, meshes = left_over.shape[0], vertices.shape[0]
    vertices = vertices.contiguous()
    # One piece of memory, so that one copy brings it to the host.
    both = torch.empty(3 * count + 6 * count * meshes, dtype=torch.int32, device=left_over.device)
    rows, places = both.split([3 * count, 6 * count * meshes])
    rows = rows.view(count, 3)
    with on_current_stream(vertices, vertices, left_over):
        gather_ends(
            as_warp(left_over, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(rows, wp.int32),
            as_warp(places.view(torch.float32).view(2 * count, meshes, 3), wp.vec3),
        )
    host = both.cpu().numpy()
    bits = host[3 * count :].reshape(2 * count, 3 * meshes)
    return rows, join_on_host(host[: 3 * count].reshape(count, 3), bits.view(np.float32))


def _on_host(edges: Tensor) -> np.ndarray:
    return _remembered(_seen_host, edges, lambda: edges.cpu().numpy().copy())


def _remembered(seen: WeakIdKeyDictionary, about: Tensor, find: Callable[[], Any], count: int = 0) -> Any:
    """What `find` found for a tensor, as long as nobody writes into it, and `count` stays."""
    now = _state(about, count)
    known: tuple[Any, Any] | None = seen.get(about)
    if known is None or known[0] is None or known[0] != now:
        known = (now, find())
        seen[about] = known
    return known[1]


def _state(about: Tensor, count: int) -> tuple[int, int] | None:
    """What is remembered about a tensor holds as long as this stays."""
    version = version_of(about)
    return None if version is None else (version, count)
