"""Faces that meet at an edge, and edges that are left unmatched: what faces say by themselves, found once."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, TypeAlias

import torch
import warp as wp
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.errors import MeshError
from sdm.kernels.topology.edge_pairing import FLAGS, pair_edges
from sdm.kernels.topology.edge_table import pair_by_table
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace


@dataclass
class Pairing:
    """Pairing of faces along their edges: what depends on faces alone, wherever their vertices are.

    Args:
        unmatched: (N,3) int32, edges with more faces in one direction than in the other, as
            `sdm.kernels.topology.edge_pairing` gives them.
        neighbours: (F,4) int32, see the function of that name.
        edges: (E,2) int32, the last boundary found.
        same: (2 * N,) int32, of the vertices that it was found for, see `sdm.topology.same_boundary`; or nobody knows.
        ready: When `neighbours` is written, if nobody has waited for that yet.
    """

    unmatched: Tensor
    neighbours: Tensor
    edges: Tensor | None = None
    same: Tensor | None = None
    ready: torch.cuda.Event | None = None


class _Known(NamedTuple):
    """A pairing that was found for faces, or what makes it, and the state in which they were seen."""

    faces: Callable[[], Tensor | None]
    state: tuple[int, int] | None
    pairing: Pairing | Callable[[], Pairing]


# What is remembered once it is known: faces' identity, a reference to them, and their state before.
Noted: TypeAlias = tuple[int, Callable[[], "Tensor | None"], "tuple[int, int] | None"]
# Of faces seen before, by their identity while they live, so that of others it is known at once: a stream asks about
# the same ones for every batch. Who writes into it is here alone.
known: dict[int, _Known] = {}


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
    return pairing_of(faces, count).neighbours


def pairing_of(faces: Tensor, count: int) -> Pairing:
    """The pairing of faces (F,3) of so many vertices: found once, as long as torch writes nothing into them.

    Raises:
        MeshError: A face index out of range.
    """
    found = _known_pairing(faces, count)
    if found is None:
        # From one sort of all edges; waits for the device once.
        note = noted(faces, count)
        found = PairingUnderWay(faces.contiguous(), count).finish()
        remember_noted(note, found)
    ready = found.ready
    if ready is not None:
        with torch.cuda.device(found.neighbours.device):
            # Who captures has called before, so it is long there; an event of before must not be waited for then.
            if not torch.cuda.is_current_stream_capturing():
                torch.cuda.current_stream().wait_event(ready)
                if ready.query():
                    found.ready = None
    return found


def is_known(faces: Tensor, count: int) -> bool:
    """True if these faces were paired before, so that nothing has to wait for their pairing."""
    return id(faces) in known and _known_pairing(faces, count) is not None


def _known_pairing(faces: Tensor, count: int) -> Pairing | None:
    found = known.get(id(faces))
    if found is None or found.faces() is not faces:
        return None
    # As `state_of`.
    if faces.is_inference() or found.state != (faces._version, count):
        return None
    pairing = found.pairing
    if not isinstance(pairing, Pairing):
        pairing = pairing()
        known[id(faces)] = found._replace(pairing=pairing)
    return pairing


def remember_closed(faces: Tensor, count: int, around: Tensor) -> None:
    """Remember of faces that none of their edges is unmatched, and their neighbours (F,4).

    The neighbours may still be under way on the current stream of their device: other streams wait when they ask.
    """
    ready = None
    if around.is_cuda:
        ready = torch.cuda.Event()
        ready.record(torch.cuda.current_stream(around.device))
    remember(faces, count, closed_pairing(around, ready))


def closed_pairing(around: Tensor, ready: torch.cuda.Event | None) -> Pairing:
    """The pairing of faces none of whose edges is unmatched: their neighbours (F,4) are there by `ready`."""
    return Pairing(_no_edges(around.device), around, ready=ready)


@lru_cache(maxsize=16)
def _no_edges(device: torch.device) -> Tensor:
    """No unmatched edges (0,3): one for all closed meshes, as nobody writes into it."""
    with torch.inference_mode(False):
        return torch.empty((0, 3), dtype=torch.int32, device=device)


def remember(faces: Tensor, count: int, pairing: Pairing) -> None:
    """Remember the pairing of faces and so many vertices, for `pairing_of`."""
    remember_noted(noted(faces, count), pairing)


def noted(faces: Tensor, count: int) -> Noted:
    """Faces of so many vertices as they are now, of which `remember_noted` will remember something."""
    number = id(faces)
    return number, weakref.ref(faces, partial(_forget, number)), state_of(faces, count)


def remember_noted(note: Noted, pairing: Pairing | Callable[[], Pairing]) -> None:
    """`remember` a pairing, or what makes it once somebody asks: views of tensors take the host as long as launches."""
    number, faces, state = note
    known[number] = _Known(faces, state, pairing)


def _forget(number: int, gone: Any) -> None:
    """Faces are gone; another object may have their number by now."""
    found = known.get(number)
    if found is not None and found.faces is gone:
        del known[number]


def queue_pairing(
    faces: Tensor,
    count: int,
    within: Tensor | None = None,
    *,
    by_table: bool = False,
    zeros: Tensor | None = None,
    **of_table: Any,
) -> tuple[Tensor, Tensor, Tensor]:
    """The pairing by `sdm.kernels.topology.edge_pairing` of contiguous faces, once the device gets there.

    Returns:
        The flags (FLAGS,), the unmatched edges (3 * F, 3) or more rows, of which the flags tell how many, and (F,4)
        what `neighbours` returns: all int32. No index out of range does harm here, and in `within` (F,3), if it is
        given, the faces are written without any: each is brought into it. `by_table`: by `edge_table`, of faces without
        any. `zeros` (FLAGS + count,) int32: memory for the flags, which come first, and the search, if it is there.
        `of_table`: more of `pair_by_table`, as tensors.
    """
    total = faces.numel()
    if zeros is None:
        zeros = torch.empty(FLAGS + count, dtype=torch.int32, device=faces.device)
        if zeros.is_cuda:
            zeros.zero_()
        else:
            # Without torch's threads, which take longer to meet.
            zeros.numpy().fill(0)
    flags, first = zeros.split([FLAGS, count])
    # Whoever has room for more than there can be tells of all rows that there is room for.
    rows = max(total, of_table.get("most", 0))
    unmatched = torch.empty(rows, 3, dtype=torch.int32, device=faces.device)
    around = torch.empty(faces.shape[0], 4, dtype=torch.int32, device=faces.device)
    with on_current_stream(faces, faces):
        empty = workspace(faces.device)
        given, firsts, found, edges, beside = (
            as_warp(each, wp.int32) for each in (faces, first, flags, unmatched, around)
        )
        if by_table:
            more: dict[str, Any] = {
                name: as_warp(it, wp.int32) if isinstance(it, Tensor) else it for name, it in of_table.items()
            }
            pair_by_table(given, firsts, found, edges, beside, empty, **more)
        else:
            brought = None if within is None else as_warp(within, wp.int32)
            pair_edges(given, firsts, found, edges, beside, empty, brought)
    return flags, unmatched, around


class PairingUnderWay:
    """A pairing whose kernels are queued, and whose flags are on their way to the host.

    Args:
        faces: (F,3) int32, contiguous.
        count: Number of vertices.
        within: See `queue_pairing`.

    `found` and `neighbours` are those of `queue_pairing`.
    """

    def __init__(self, faces: Tensor, count: int, within: Tensor | None = None) -> None:
        self._faces, self._count = faces, count
        flags, self._unmatched, self.neighbours = queue_pairing(faces, count, within)
        self.found, self._flags, self._there = flags, flags, None
        if flags.is_cuda:
            self._flags = torch.empty(FLAGS, dtype=torch.int32, pin_memory=True)
            self._flags.copy_(flags, non_blocking=True)
            self._there = torch.cuda.Event()
            self._there.record(torch.cuda.current_stream(flags.device))

    def finish(self) -> Pairing:
        """The pairing, once the device has found it.

        Raises:
            MeshError: A face index out of range.
        """
        if self._there is not None:
            self._there.synchronize()
        out_of_range, open_edges = self._flags.tolist()
        if out_of_range:
            low, high = (int(bound) for bound in self._faces.aminmax())
            bad = low if low < 0 else high
            raise MeshError(
                f"a face uses vertex {bad}, but the {self._count} vertices are numbered 0 to {self._count - 1}"
            )
        unmatched = self._unmatched[:open_edges] if open_edges else self._unmatched.new_empty((0, 3))
        return Pairing(unmatched, self.neighbours)


def state_of(tensor: Tensor, count: int = 0) -> tuple[int, int] | None:
    """State of a tensor and `count`: what was found for them holds as long as this stays.

    None if torch does not count writes into the tensor, as of those made in inference mode.
    """
    return None if tensor.is_inference() else (tensor._version, count)


def cached(cache: WeakIdKeyDictionary, about: Tensor, find: Callable[[], Any]) -> Any:
    """The result of `find` for a tensor, kept as long as torch writes nothing into it."""
    now = state_of(about)
    known: tuple[Any, Any] | None = cache.get(about)
    if known is None or now is None or known[0] != now:
        known = (now, find())
        cache[about] = known
    return known[1]
