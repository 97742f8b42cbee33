"""Faces turned patch by patch, so that what is seen from outside faces outward."""

from __future__ import annotations

import numpy as np
import torch
from torch.utils.weak import WeakIdKeyDictionary

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.engine.orient.visible_sides import Sides, visible_sides
from sdm.inspect.agreement import agreeing_turns
from sdm.inspect.duplicates import first_copies
from sdm.inspect.positions import first_at_position

# A patch is seen from outside if this share of the rays from its better side meets nothing; one whose faces agree, and
# that has no rim, keeps its meaning inside another unless it is seen as well as this.
SEEN, WELL_SEEN = 0.01, 0.25
# One side is seen better than the other by so many standard deviations.
CLEARLY = 4.0
# Copies of a face that are patches of their own.
MOST_COPIES = 4
# A patch lies wholly inside others if so many of its rays agree.
WHOLLY = 0.9

# Turned faces by mesh: whoever keeps a mesh keeps its vertices.
_known: WeakIdKeyDictionary = WeakIdKeyDictionary()


def orient_faces(mesh: MeshLike, device: str | torch.device | None = None) -> TriangleMesh:
    """Make the faces of each patch agree, and turn it outward by what sees it from outside.

    1. Where faces that share an edge disagree, the fewer (by area) are turned. A patch is what edges of exactly two
       faces hold together; one-sided patches stay as they are.
    2. From random points of each patch rays go to both sides. If those of one side meet nothing clearly more often,
       that is the front (Takayama, Jacobson, Kavan and Sorkine-Hornung, A simple method for correcting facet
       orientations in polygon meshes based on ray casting, JCGT 3(4), 2014).
    3. Patches that are not seen from outside keep their meaning beside the one around them: a shell inside another one
       is turned if that is. If their own faces disagreed, they have none: those that lie wholly inside become the walls
       of cavities, with the front where rays meet an even number of faces; those that cross others enclose a volume.

    Args:
        mesh: Any mesh, or whatever `as_mesh` takes for one.
        device: Where rays are followed; by default where the mesh is, else a GPU if there is one.

    Returns:
        The same object if nothing is to be turned; else a mesh with the same vertices, and turned faces: the same ones
        for the same mesh, whatever the device, but for patches both of whose sides are seen alike.

    Raises:
        DeviceError: The device is not there.
    """
    mesh = as_mesh(mesh)
    where = choose_device(device, mesh.vertices)
    state = None if mesh.faces.is_inference() else (mesh.vertices._version, mesh.faces._version)
    known = _known.get(mesh.vertices)
    if known is not None and state is not None and known[0] is mesh.faces and known[1] == state:
        faces = known[2]
    else:
        turn = _turns(mesh, where)
        host = mesh.faces.cpu().numpy()
        faces = torch.from_numpy(np.where(turn[:, None], host[:, ::-1], host)).to(mesh.device) if turn.any() else None
        _known[mesh.vertices] = mesh.faces, state, faces
    return mesh if faces is None else TriangleMesh(mesh.vertices, faces, mesh.name, check=False)


def _turns(mesh: TriangleMesh, device: torch.device) -> np.ndarray:
    """The faces to turn (F,)."""
    vertices, faces = mesh.numpy()
    merged = first_at_position(vertices)[faces.astype(np.int64)]
    like = _represented(merged, len(vertices))
    if like is None:
        return _turns_of(mesh, merged, device)
    kept = np.flatnonzero(like == np.arange(len(faces)))
    some = TriangleMesh(mesh.vertices, mesh.faces[torch.from_numpy(kept).to(mesh.device)], mesh.name, check=False)
    turn = np.zeros(len(faces), bool)
    turn[kept] = _turns_of(some, merged[kept], device)
    return turn[like]


def _represented(merged: np.ndarray, vertices: int) -> np.ndarray | None:
    """For each face the number (F,) of the one that it is turned with: itself, or a copy; None if there are few.

    Each copy of a face is a patch with rays of its own, which would meet all the others. Of very many three or four are
    left, as odd or even as they all are, so that their edges still hold no patch together and rays count alike.
    """
    first, same_side = first_copies(merged, vertices)
    group = 2 * first + same_side
    if np.bincount(group).max(initial=0) <= MOST_COPIES:
        return None
    order = np.argsort(group, kind="stable")
    begin = np.flatnonzero(np.diff(group[order], prepend=-1))
    count = np.diff(np.append(begin, len(order)))
    rank = np.arange(len(order)) - np.repeat(begin, count)
    drop = (rank >= np.repeat(MOST_COPIES - count % 2, count)) & np.repeat(count > MOST_COPIES, count)
    like = np.arange(len(merged))
    like[order[drop]] = np.repeat(order[begin], count)[drop]
    return like


def _turns_of(mesh: TriangleMesh, merged: np.ndarray, device: torch.device) -> np.ndarray:
    vertices, faces = mesh.numpy()
    corners = vertices[faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    turn, patch, count = agreeing_turns(merged, area)
    uneven = np.bincount(patch, turn, minlength=count) > 0
    sides = visible_sides(mesh, turn, patch, count, device)
    zero = corners[0, 0]
    a, b, c = np.moveaxis(np.where(turn[:, None, None], corners[:, ::-1], corners) - zero, 1, 0)
    volume = np.bincount(patch, (a * np.cross(b, c)).sum(1), minlength=count)
    return turn ^ _inward(sides, uneven, _shut(merged, patch, count), volume)[patch]


def _inward(sides: Sides, uneven: np.ndarray, shut: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """The patches (P,) whose front is to be their back."""
    better = np.maximum(sides.front, sides.back)
    keeps = shut & ~uneven
    seen = (sides.points > 0) & (better >= np.where(keeps, WELL_SEEN, SEEN) * sides.points)
    turned = seen & (sides.back - sides.front > CLEARLY * np.sqrt(sides.front + sides.back))
    # Beside a patch whose own faces disagreed nothing has a meaning.
    around = np.where((sides.around >= 0) & ~uneven[sides.around] & seen[sides.around], sides.around, -1)
    with_it = (around >= 0) & turned[around]
    crosses = shut & (np.abs(sides.even) < WHOLLY * sides.points)
    alone = np.where(crosses, volume < 0, sides.even < 0)
    return np.where(seen, turned, np.where(uneven, alone, with_it))


def _shut(merged: np.ndarray, patch: np.ndarray, count: int) -> np.ndarray:
    """The patches (P,) of whose faces no edge is used an odd number of times."""
    following = np.roll(merged, -1, 1)
    proper = (merged != following).all(1)
    start, end, owner = merged[proper].reshape(-1), following[proper].reshape(-1), np.repeat(patch[proper], 3)
    width = int(merged.max(initial=0)) + 1
    key = np.minimum(start, end) * width + np.maximum(start, end)
    order = np.lexsort((key, owner))
    key, owner = key[order], owner[order]
    begin = np.flatnonzero(np.concatenate([[True], (key[1:] != key[:-1]) | (owner[1:] != owner[:-1])]))
    odd = np.diff(np.append(begin, len(key))) % 2 == 1
    found = np.ones(count, bool)
    found[owner[begin[odd]]] = False
    return found
