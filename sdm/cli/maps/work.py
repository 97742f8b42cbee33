"""The work on one mesh as it goes through the stages: read, measured, written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.normalization import Normalization
from sdm.core.signed_distance_map import SDM
from sdm.runtime.host_copy import HostCopy


@dataclass(frozen=True)
class MapTask:
    """A mesh file, the map's file, and the name by which lines tell of the mesh."""

    source: Path
    target: Path
    name: str = ""

    def absolute(self) -> MapTask:
        """The same, whatever the working folder."""
        return MapTask(self.source.absolute(), self.target.absolute(), self.name)


@dataclass(frozen=True)
class ReadMesh:
    """A mesh that was read.

    Args:
        task: Its files.
        mesh: As it is placed.
        measured: The same, with its faces turned if that was wanted.
        normalization: What it was placed by, if it was normalised.
        grid: Of its map.
        digest: Of what the map is made from.
        there: Whether the map is there already.
        seconds: That this took.
        closed: Whether it is known already that the measured mesh has no boundary.
    """

    task: MapTask
    mesh: TriangleMesh
    measured: TriangleMesh
    normalization: Normalization | None
    grid: Grid
    digest: str
    there: bool
    seconds: float
    closed: bool = False

    @property
    def nbytes(self) -> int:
        """Memory of the mesh, about."""
        return self.mesh.vertices.nbytes + self.mesh.faces.nbytes


@dataclass(frozen=True)
class Measured:
    """A mesh with its map.

    Args:
        read: The mesh.
        map: The map on its way to the host; None if it is in its file already.
        inside: Voxels inside, where that is known already.
        ambiguous: Voxels whose side is ambiguous.
        seconds: That it took so far, of several that were measured together a share.
    """

    read: ReadMesh
    map: HostCopy[SDM] | None
    inside: int | None
    ambiguous: int
    seconds: float

    @property
    def nbytes(self) -> int:
        """Memory of the map, about, with what writing takes."""
        return 2 * self.read.grid.nbytes if self.map is not None else 0


@dataclass(frozen=True)
class Written:
    """A mesh whose map is in its file.

    Args:
        read: The mesh.
        closed: Whether the mesh has no boundary.
        inside: Voxels inside.
        ambiguous: Voxels whose side is ambiguous.
        seconds: That it took in all stages.
        warnings: What there is to know about the map, as the lines that are printed go on after the mesh's name.
    """

    read: ReadMesh
    closed: bool
    inside: int | None = None
    ambiguous: int | None = None
    seconds: float = 0.0
    warnings: list[str] = field(default_factory=list)
