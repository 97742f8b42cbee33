"""Kinds of meshes by their winding numbers, and sizes that the arrays of a structure follow from."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from sdm.kernels.bvh import tree
from sdm.kernels.winding import cap_tree, winding_number

# Above this many boundary edges the tree of dipoles costs less than visiting every edge for one point; above the second
# number also than visiting them for a group of points.
MOST_BOUNDARY_EDGES = 1024
MOST_FOR_GROUPS = 8192
# Only of a surface with holes, though: of loose triangles, whose edges are all boundary, no group is far from any.
FEWEST_FACES_AN_EDGE = 16
# Above this many no voxel of a map can have them all visited.
MOST_FOR_VOXELS = 1 << 18


class MeshKind(IntEnum):
    """Method by which a mesh's winding numbers are found; the numbers are the kernels'."""

    CLOSED = winding_number.CLOSED
    OPEN = winding_number.OPEN
    MANY = winding_number.MANY
    DIRTY = winding_number.DIRTY
    SOUP = winding_number.SOUP
    UNSIGNED = winding_number.UNSIGNED  # of points whose side nobody asks for


# Kinds whose boundary edges are visited one by one, and those with a tree of dipoles.
VISITING = frozenset((MeshKind.OPEN, MeshKind.MANY, MeshKind.DIRTY))
WITH_DIPOLES = frozenset((MeshKind.MANY, MeshKind.DIRTY, MeshKind.SOUP))


def kind_of(edges: int, faces: int) -> MeshKind:
    """The kind of a mesh with so many boundary edges and faces."""
    if edges == 0:
        return MeshKind.CLOSED
    if edges <= MOST_BOUNDARY_EDGES:
        return MeshKind.OPEN
    if edges <= MOST_FOR_GROUPS and edges * FEWEST_FACES_AN_EDGE <= faces:
        return MeshKind.MANY
    return MeshKind.DIRTY if edges <= MOST_FOR_VOXELS else MeshKind.SOUP


def closed_by_faces(kind: MeshKind, edges: int, faces: int) -> bool:
    """True if a mesh's faces, turned inside out, are fewer caps of its holes than triangles between their edges."""
    return kind is MeshKind.DIRTY and edges > faces


class Sizes(NamedTuple):
    """Sizes that all arrays' shapes follow from."""

    meshes: int
    faces: int  # of each mesh
    edges: int  # boundary edges of each mesh
    kind: MeshKind

    @property
    def slots(self) -> int:
        """Triangles of all meshes."""
        return self.meshes * self.faces

    @property
    def nodes(self) -> int:
        """Nodes of all hierarchies."""
        return self.meshes << (tree.depth_for(self.faces) + 1)

    @property
    def visited_edges(self) -> int:
        """Boundary edges of all meshes, if they are visited."""
        return self.meshes * self.edges if self.kind in VISITING else 0

    @property
    def caps(self) -> int:
        """Triangles of each mesh that close its holes."""
        if self.kind not in VISITING:
            return 0
        return self.faces if closed_by_faces(self.kind, self.edges, self.faces) else self.edges

    @property
    def all_caps(self) -> int:
        """Those of all meshes."""
        return self.meshes * self.caps

    @property
    def cap_nodes(self) -> int:
        """Nodes of all trees of caps."""
        return self.meshes << (cap_tree.depth_of_caps(self.caps) + 1) if self.caps else 0

    @property
    def dipole_nodes(self) -> int:
        """Nodes of all trees of dipoles."""
        return self.nodes if self.kind in WITH_DIPOLES else 0
