"""The cases of marching cubes: the loops in which a surface crosses a cell, and their triangles.

A cell has eight voxel centres as corners, corner 4x + 2y + z, and twelve edges, edge 4a + n along axis a. Where the
corners of a face are inside, outside, inside, outside in turn, the face is ambiguous: its inside corners are either
joined or apart. Both cells of a face decide that alike, from its four values (`is_joined`), so the surface has no
cracks. Each edge that it crosses has one vertex, and each face then says which vertices follow each other; they form
closed loops, 656 cases in all.

A loop is divided into triangles without a diagonal between two vertices of one face: the cell beyond might draw the
same, and four triangles would meet in it. A loop that has no such division has a vertex at its middle. So every edge of
the surface has exactly two triangles, one each way. No triangle lies in a face, and no three points of a cell's edges
are on one line, so no triangle has an area of zero while all vertices lie strictly between the ends of their edges.

The cases are derived here rather than copied: they follow from the rule of the faces alone. Source of that rule:
Nielson and Hamann, The asymptotic decider, Visualization 1991.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

AXES = (4, 2, 1)
EDGES = [(axis, corner) for axis in range(3) for corner in range(8) if not corner & AXES[axis]]
# A triangle's vertex CENTRE + n is the middle of loop n.
CENTRE = 12
NO_LOOP = 15


@dataclass(frozen=True)
class CellCases:
    """Tables of all cases, int32.

    Args:
        first: (256) the first case of a cell whose corners c with bit c set are inside.
        ambiguous: (256) a bit for each ambiguous face. A case is `first` plus those of their bits "joined", packed.
        triangles: (3T) vertices of triangles, case after case: edges of the cell, or middles of loops.
        start: (cases + 1) the first triangle of each case.
        centres: (cases) a bit for each loop that has a vertex at its middle.
        loops: (cases) number of loops.
        loop: (12 cases) the loop of each edge, NO_LOOP if the surface does not cross it.
        opposite: (12) of each face, two of its edges that have no common corner.
        corners: (24) the corners of the six faces, in turn; faces 2a and 2a + 1 are the low and the high one of axis a.
    """

    first: np.ndarray
    ambiguous: np.ndarray
    triangles: np.ndarray
    start: np.ndarray
    centres: np.ndarray
    loops: np.ndarray
    loop: np.ndarray
    opposite: np.ndarray
    corners: np.ndarray


def _faces() -> list[list[int]]:
    """Corners of each face, counter-clockwise seen from outside the cell."""
    faces = []
    for axis in range(3):
        one, other = AXES[(axis + 1) % 3], AXES[(axis + 2) % 3]
        for side in (0, AXES[axis]):
            turn = [side, side | one, side | one | other, side | other]
            faces.append(turn if side else turn[::-1])
    return faces


FACES = _faces()


def _edge(one: int, other: int) -> int:
    return EDGES.index((AXES.index(one ^ other), min(one, other)))


_FACE_EDGES = [[_edge(face[n], face[(n + 1) % 4]) for n in range(4)] for face in FACES]


@cache
def _links(number: int, bits: tuple[int, ...], joined: int) -> list[tuple[int, int]]:
    """Pairs of crossed edges of a face, of which the surface's loop goes from the one to the other."""
    leaving = [n for n in range(4) if bits[n] and not bits[(n + 1) % 4]]
    entering = [n for n in range(4) if bits[(n + 1) % 4] and not bits[n]]
    # Around inside corners that are apart, around outside ones where the inside is joined.
    way = 1 if joined else -1
    begins = [min(entering, key=lambda n, end=end: way * (n - end) % 4) for end in leaving]
    edges = _FACE_EDGES[number]
    return [(edges[begin], edges[end]) for begin, end in zip(begins, leaving, strict=True)]


def _loops(bits: list[tuple[int, ...]], joined: int) -> list[tuple[int, ...]]:
    """Loops of edges that the surface crosses, counter-clockwise seen from outside the surface.

    Args:
        bits: Of each face, 1 for its corners inside.
        joined: A bit for each face whose inside corners are joined.
    """
    following: dict[int, int] = {}
    for number, corners in enumerate(bits):
        following.update(_links(number, corners, joined >> number & 1))
    loops = []
    while following:
        edge = min(following)
        loop = []
        while edge in following:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(tuple(loop))
    return loops


def _middle(edge: int) -> np.ndarray:
    axis, corner = EDGES[edge]
    place = np.array([corner >> 2 & 1, corner >> 1 & 1, corner & 1], np.float64)
    place[axis] = 0.5
    return place


def _costs() -> list[list[float]]:
    """Lengths of diagonals between the middles of two edges; infinite where one would lie in a face."""
    middles = np.array([_middle(edge) for edge in range(12)])
    lengths = np.linalg.norm(middles[:, None] - middles, axis=2)
    for edges in _FACE_EDGES:
        lengths[np.ix_(edges, edges)] = np.inf
    return lengths.tolist()


_COSTS = _costs()


@cache
def _division(loop: tuple[int, ...]) -> list[tuple[int, int, int]] | None:
    """The triangles of a loop with the shortest diagonals; None if each division has a diagonal in a face."""
    count = len(loop)
    # Of the vertices from one to another: the cost, and the vertex beyond the diagonal between the two.
    costs, choice = [[0.0] * count for _ in loop], {}
    for width in range(2, count):
        for begin in range(count - width):
            end = begin + width
            diagonal = 0.0 if width == count - 1 else _COSTS[loop[begin]][loop[end]]
            before, options = costs[begin], range(begin + 1, end)
            cost, k = min([(before[k] + costs[k][end] + diagonal, k) for k in options])
            before[end], choice[begin, end] = cost, k
    if costs[0][-1] == np.inf:
        return None

    def triangles(begin: int, end: int) -> list[tuple[int, int, int]]:
        if end == begin + 1:
            return []
        k = choice[begin, end]
        return [*triangles(begin, k), *triangles(k, end), (loop[begin], loop[k], loop[end])]

    return triangles(0, count - 1)


@cache
def cell_cases() -> CellCases:
    """The tables, worked out once a process."""
    first, ambiguous, start, centres, loops, loop_of = [], [], [0], [], [], []
    triangles: list[tuple[int, int, int]] = []
    for inside in range(256):
        bits = [tuple([inside >> corner & 1 for corner in face]) for face in FACES]
        unclear = [n for n, face in enumerate(bits) if face[0] == face[2] != face[1] == face[3]]
        first.append(len(loops))
        ambiguous.append(sum(1 << n for n in unclear))
        for packed in range(1 << len(unclear)):
            joined = sum(1 << n for place, n in enumerate(unclear) if packed >> place & 1)
            found = _loops(bits, joined)
            row, middles = [NO_LOOP] * 12, 0
            for number, loop in enumerate(found):
                for edge in loop:
                    row[edge] = number
                parts = _division(loop)
                if parts is None:
                    middles |= 1 << number
                    parts = [(loop[n - 1], edge, CENTRE + number) for n, edge in enumerate(loop)]
                triangles += parts
            start.append(len(triangles))
            centres.append(middles)
            loops.append(len(found))
            loop_of += row
    opposite = [edges[n] for edges in _FACE_EDGES for n in (0, 2)]
    triples = np.array(triangles).reshape(-1)
    tables = (first, ambiguous, triples, start, centres, loops, loop_of, opposite, np.ravel(FACES))
    return CellCases(*(np.array(table, np.int32) for table in tables))
