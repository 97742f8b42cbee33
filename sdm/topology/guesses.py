"""Guesses about the topology of faces never seen before, from those of as many vertices and faces."""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

from torch import Tensor

from sdm.runtime.graphs import Verify
from sdm.topology.boundary_edges import MeshTopology
from sdm.topology.cap_triangles import cap_triangles
from sdm.topology.device_joining import boundary_on_device, queue_joining
from sdm.topology.face_pairing import Pairing, PairingUnderWay, pairing_of, queue_pairing

# Of more unmatched edges no numbers are guessed; numbers of faces and vertices that are kept.
MOST_GUESSED, MOST_KEPT = 1 << 10, 64
# Of more it is not remembered whether the device could follow them.
MOST_REMEMBERED = 1 << 11


class Guess(NamedTuple):
    """A mesh's topology in numbers: zeros for a closed one."""

    unmatched: int = 0  # edges that faces leave unmatched by their vertices' indices
    boundary: int = 0  # boundary edges, once vertices at equal positions count as one


CLOSED = Guess()

# Of the last open mesh, by numbers of faces and vertices; None if it was not one to guess by. Written here alone.
last_open: OrderedDict[tuple[int, int], Guess | None] = OrderedDict()


def guess(faces: Tensor, count: int) -> Guess:
    """The numbers of the last open mesh with as many faces and vertices; of a closed one if there was none.

    Nor if the kernels of `queue_guessed` are not made for so many.
    """
    return CLOSED if is_hopeless(faces, count) else last_numbers(faces, count) or CLOSED


def is_hopeless(faces: Tensor, count: int) -> bool:
    """True if the last open mesh with as many faces and vertices has numbers that are not to be guessed by."""
    last = last_numbers(faces, count)
    return last is None or last.unmatched > MOST_GUESSED or (last.unmatched > 0 and last.boundary == 0)


def last_numbers(faces: Tensor, count: int) -> Guess | None:
    """The numbers of the last open mesh with as many faces and vertices, of a closed one if there was none.

    None if the device does not join the edges of such meshes.
    """
    return last_open.get((faces.shape[0], count), CLOSED)


def remember(faces: Tensor, count: int, edges: Tensor, simple: bool = False) -> None:
    """Remember the boundary `edges` (E,2) that faces turned out to have, for the next guess.

    If they are `simple`, they were followed on the device.
    """
    unmatched = pairing_of(faces, count).unmatched.shape[0]
    if unmatched == 0:
        last_open.pop((faces.shape[0], count), None)
        return
    remember_numbers(faces, count, Guess(unmatched, edges.shape[0]) if simple or unmatched <= MOST_REMEMBERED else None)


def remember_numbers(faces: Tensor, count: int, numbers: Guess | None) -> None:
    """Remember the numbers of an open mesh, for the next guess; None if nobody should guess by them."""
    key = faces.shape[0], count
    last_open.pop(key, None)
    last_open[key] = numbers
    while len(last_open) > MOST_KEPT:
        last_open.popitem(last=False)


def is_right(guessed: Guess, faces: Tensor, count: int) -> bool:
    """True if `queue_guessed` would find faces that were paired before as they were guessed to be."""
    return guessed != CLOSED or pairing_of(faces, count).unmatched.shape[0] == 0


def queue_guessed(guessed: Guess, vertices: Tensor, faces: Tensor, verify: Verify) -> MeshTopology:
    """Queue the kernels that find a mesh's topology, if the guess is right: `vertices` (V,3), `faces` contiguous.

    `verify` gets flags that are zeros if it is; else the rest has no meaning, but indices are in range.
    """
    found, unmatched, neighbours = queue_pairing(faces, vertices.shape[0])
    if guessed == CLOSED:
        verify(found)
        none = faces.new_empty((0, 2))
        return MeshTopology(neighbours, none, none)
    flags, edges, caps = queue_joining(unmatched, found, vertices[None], guessed.unmatched, guessed.boundary)
    verify(flags)
    last = vertices.shape[0] - 1
    return MeshTopology(neighbours, edges.clamp(0, last), caps.clamp(0, last))


def topology_on_device(
    under_way: PairingUnderWay, pairing: Pairing, vertices: Tensor, faces: Tensor
) -> MeshTopology | None:
    """The topology of one open mesh (V,3) whose faces were just paired, found on the device.

    Caps are those of its loops. None if that does not serve, see `boundary_on_device`.
    """
    edges = boundary_on_device(pairing, vertices, under_way.found)
    if edges is None:
        return None
    remember(faces, vertices.shape[0], edges, simple=edges.shape[0] > 0)
    return MeshTopology(pairing.neighbours, edges, cap_triangles(edges))
