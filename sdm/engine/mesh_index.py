"""Mesh index: a mesh with its acceleration structure, built once and queried often."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

import torch
from jaxtyping import Float32
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.signed_distance_map import SDM
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.arguments import ComparedSignOptions, Orient, Sign, SignMethod, SignOptions, described, oriented
from sdm.engine.checks.map_check import MapCheck, checked
from sdm.engine.checks.values_check import SlabsCheck
from sdm.engine.closest_points import Closest, Layers
from sdm.engine.flood import flooded, rims_of
from sdm.engine.map_closest import VOXEL_BYTES, ClosestMap, closest_map
from sdm.engine.maps import (
    LARGEST_SLAB,
    batch_maps,
    index_map,
    is_recordable,
    moves_without_wait,
    put_together,
    slabs_of,
    unsigned_index_map,
)
from sdm.engine.ops import map_slab, points_distance, points_winding, structure_slab
from sdm.engine.points import as_points, at_points
from sdm.engine.repeated_faces import RepeatedFaces, may_be_crowded, repeated_faces
from sdm.errors import MeshError
from sdm.runtime.host_copy import number_later
from sdm.runtime.operators import is_eager
from sdm.runtime.torch_warp import refuse_other_modes
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.face_pairing import pairing_of

if TYPE_CHECKING:
    from sdm.core.sparse_sdm import SparseSDM
    from sdm.engine.band.calls import BandGrid


class MeshIndex:
    """A mesh with its acceleration structure: built once, queried often.

    Args:
        mesh: The mesh, or whatever `as_mesh` takes for one: a path, (vertices, faces), a mesh of another library.
            Gradients flow to its vertices where they require them.
        device: `"cuda"`, `"cuda:1"`, `"cpu"`; by default the mesh's own if that is a GPU, else a GPU if there is
            one, else the CPU.
        orient: `"auto"` makes faces agree and turns parts that are inside out, see `sdm.inspect.orient_outward`;
            `"parts"` turns every patch of faces outward by what sees it from outside, see `sdm.orient_faces`; `"keep"`
            takes every mesh as it is.
        warn: Raise an `SDMWarning`, one at most, if a whole map is probably not what was meant.

    Raises:
        DeviceError: The device is not there.
        MeshError: What is given is no mesh, or one that cannot be used.

    Takes about 350 bytes a triangle of memory on the device (420 for a mesh with more than 1024 boundary edges).
    Queries may run on any torch stream; between streams the caller orders the work, as for any tensor. Pickled or
    copied it is the mesh alone, and its structure is built again, on a device of the same name.
    """

    def __init__(
        self,
        mesh: MeshLike,
        device: str | torch.device | None = None,
        *,
        orient: Orient = "keep",
        warn: bool = True,
    ) -> None:
        if not isinstance(mesh, TriangleMesh):
            mesh = as_mesh(mesh)
        refuse_other_modes(mesh.vertices)
        self.device = choose_device(device, mesh.vertices)
        self.mesh = oriented(mesh, orient, self.device).to(self.device)
        self._check = MapCheck() if warn else None
        self._edges = boundary_edges(self.mesh.vertices, self.mesh.faces)
        self._build()

    def __reduce__(self) -> tuple[Any, ...]:
        vertices = self.mesh.vertices
        kept = vertices if vertices.is_leaf else vertices.detach()
        mesh = TriangleMesh(kept, self.mesh.faces, self.mesh.name, check=False)
        return partial(MeshIndex, warn=self._check is not None), (mesh, str(self.device))

    def _build(self) -> None:
        mesh, edges = self.mesh, self._edges
        self._repeated: RepeatedFaces | None = None
        self._rims: Tensor | None = None
        if may_be_crowded(mesh, edges):
            self._repeated = repeated_faces(mesh)
        if self._repeated is not None:
            mesh, edges = self._repeated.distinct, None
        self._measured = mesh
        self._built: AccelerationStructure | None = build(mesh.vertices.detach()[None], mesh.faces, edges)

    @property
    def _structure(self) -> AccelerationStructure:
        """The structure, which after a move is built by the first query that needs one by itself."""
        if self._built is None:
            self._built = build(self._measured.vertices[None], self._measured.faces, self._edges)
        return self._built

    @property
    def closed(self) -> bool:
        """True if the mesh has no boundary, so that its winding number is a whole number everywhere."""
        return self._edges.shape[0] == 0

    @property
    def _always_closed(self) -> bool:
        """True if there is no boundary wherever the vertices are."""
        paired = pairing_of(self.mesh.faces, self.mesh.vertices.shape[0])
        return self._repeated is None and paired.unmatched.shape[0] == 0

    def update(self, vertices: Any, *, check: bool | None = None) -> None:
        """Move the vertices: `vertices` (V,3), in the order of the mesh's. The faces stay.

        Args:
            vertices: Anything that can be a tensor; it is copied, or built from at once.
            check: Look for coordinates that are not finite. By default on a CPU alone: it would wait for a GPU.

        On a GPU nothing waits if the faces leave no edge unmatched, and the structure is built by what needs it: a map
        of one kind after each move is one recorded call, build and all.

        Raises:
            MeshError: Another number of vertices, or a coordinate that is not finite.
        """
        moved = as_tensor(vertices, torch.float32, f"the vertices of {self.mesh.name}", device=self.device)
        if moved.shape != self.mesh.vertices.shape:
            raise MeshError(
                f"update was given vertices of shape {tuple(moved.shape)}, but {self.mesh.name} has "
                f"{tuple(self.mesh.vertices.shape)}; build a new MeshIndex for another mesh"
            )
        refuse_other_modes(moved)
        check = moved.device.type == "cpu" if check is None else check
        if moves_without_wait(moved) and self._always_closed:
            # Whoever writes into what was given must not move the mesh.
            self.mesh = TriangleMesh(moved.clone(), self.mesh.faces, self.mesh.name, check=check)
            self._measured, self._built, self._rims = self.mesh, None, None
            return
        self.mesh = TriangleMesh(moved, self.mesh.faces, self.mesh.name, check=check)
        self._edges = boundary_edges(self.mesh.vertices, self.mesh.faces)
        self._build()

    @overload
    def signed_distance(
        self, points: Any, *, return_closest: Literal[False] = False, sign: Sign = "winding"
    ) -> Tensor: ...
    @overload
    def signed_distance(
        self, points: Any, *, return_closest: Literal[True], sign: Sign = "winding"
    ) -> tuple[Tensor, Closest]: ...
    def signed_distance(
        self, points: Any, *, return_closest: bool = False, sign: Sign = "winding"
    ) -> Tensor | tuple[Tensor, Closest]:
        """As `sdm.signed_distance`, on this index."""
        found = at_points(self._measured, points, return_closest, self._structure, self._repeated, self.mesh, sign)
        if self._check is not None:
            self._check.look_at_points(self._measured, points, found, sign)
        return found

    def distances_in(self, cube: Sequence[float], points: Float32[Tensor, "n 3"]) -> Float32[Tensor, " n"]:
        """`signed_distance` of points (N,3) float32 on the device, without gradients, by neighbours in a cube.

        Args:
            cube: Its least x, y and z, and its edge. Points are gone through in groups of neighbours: those of one
                eighth of the cube (of one eighth of that, ...) follow each other. For points in clusters that a
                division by eights keeps apart, this is faster than in the mesh's box: no group has points of two.
            points: Anywhere; the values are those of `signed_distance` wherever they are.
        """
        values = points_distance(self._measured.vertices, self._measured.faces, points, self._structure, cube)
        return values if self._repeated is None else self._repeated.signed(values, points)

    def winding_number(self, points: Any) -> Float32[Tensor, "*n"]:
        """Generalised winding number of the mesh about points (...,3): (...) float32, more than 0.5 inside.

        A whole number for closed meshes; exact to float32 for meshes with up to 1024 boundary edges; for others it is
        within 4e-4 near 0.25, 0.5 and 0.75, and elsewhere on the right side of them.

        Raises:
            MeshError: The points are not (...,3) numbers.
        """
        at = as_points(points, self.device)
        if self._repeated is not None:
            return self._repeated.winding(at.reshape(-1, 3)).reshape(at.shape[:-1])
        values = points_winding(self.mesh.vertices, self.mesh.faces, at.reshape(-1, 3), self._structure)
        return values.reshape(at.shape[:-1])

    @overload
    def signed_distance_map(
        self, grid: GridLike, *, return_closest: Literal[False] = False, **options: Unpack[ComparedSignOptions]
    ) -> SDM: ...
    @overload
    def signed_distance_map(
        self, grid: GridLike, *, return_closest: Literal[True], **options: Unpack[ComparedSignOptions]
    ) -> tuple[SDM, Closest]: ...
    def signed_distance_map(
        self,
        grid: GridLike,
        *,
        sign: Sign = "winding",
        hole_size: float | None = None,
        compare_signs: bool = False,
        return_closest: bool = False,
    ) -> SDM | tuple[SDM, Closest]:
        """As `sdm.signed_distance_map`, on this index."""
        if not isinstance(grid, Grid):
            grid = as_grid(grid, self.mesh)
        method = SignMethod(sign, hole_size, compare_signs)
        if return_closest:
            return self._map_with_closest(method, grid)
        with memory_guard(grid.nbytes, self.device, described(grid)):
            field = self._by_winding(grid) if method.is_default else self._by(method, grid)
        return checked(self._check, field, self._measured)

    def _by_winding(self, grid: Grid) -> SDM:
        if self._built is None and is_recordable(self.mesh.vertices, grid.nbytes):
            # Only maps of a mesh that moved are made so: another query builds the structure for all that follow.
            values = batch_maps(self.mesh.vertices[None], self.mesh.faces, grid, None)[0]
            return SDM(values, grid, 0, sign="winding")
        if is_recordable(self.mesh.vertices, grid.nbytes + self._structure.nbytes):
            values, ambiguous = index_map(self._structure, grid)
            field = SDM(values, grid, 0, sign="winding")
            return field if self.closed else field.counted_later(number_later(ambiguous))
        unclear = []

        def slabs() -> Iterator[tuple[int, int, Tensor]]:
            for begin, end in slabs_of(grid, LARGEST_SLAB):
                values, ambiguous = self._slab(grid, begin, end)
                unclear.append(ambiguous)
                yield begin, end, values

        values = put_together(slabs(), grid.shape[0])[0]
        # Of a closed mesh it is known without a look at the device, which would wait for it.
        count = 0 if self.closed else sum(int(ambiguous) for ambiguous in unclear)
        return SDM(values, grid, count, sign="winding")

    def _by(self, method: SignMethod, grid: Grid, winding: SDM | None = None) -> SDM:
        """The map by a method other than winding numbers alone, given that one's map if it is there."""
        if winding is None and method.compare:
            winding = self._by_winding(grid)
        if winding is not None:
            distances = winding.values.abs()
        elif is_recordable(self.mesh.vertices, grid.nbytes + self._structure.nbytes):
            distances = unsigned_index_map(self._structure, grid)
        else:
            slabs = ((begin, end, self._unsigned_slab(grid, begin, end)) for begin, end in slabs_of(grid, LARGEST_SLAB))
            distances = put_together(slabs, grid.shape[0])[0]
        return method.field(grid, distances, winding, partial(self._flooded, grid))

    @property
    def rims(self) -> Tensor:
        """Edges (E,2) of the mesh's holes, whichever way its faces face."""
        if self._rims is None:
            self._rims = rims_of(self._measured, None if self._repeated is not None else self._edges)
        return self._rims

    def _flooded(self, grid: Grid, distances: Tensor, hole: float) -> Tensor:
        closed = self.closed and self._repeated is None
        return flooded(
            distances, hole, grid=grid, structure=self._structure, mesh=self._measured, rims=self.rims, closed=closed
        )

    def _map_with_closest(self, method: SignMethod, grid: Grid) -> tuple[SDM, Closest]:
        with memory_guard(VOXEL_BYTES // 4 * grid.nbytes, self.device, f"{described(grid)} with closest points"):
            found = self._closest(grid, None)
        hit = Closest(found.points, found.faces, found.barycentric, self.mesh, grid)
        if is_eager(self.mesh.vertices):
            field = SDM(found.values, grid, 0 if self.closed else int(found.ambiguous), sign="winding")
        else:
            # The same values once more, by the operator that gradients flow through.
            field = self._by_winding(grid)
        if not method.is_default:
            field = self._by(method, grid, field)
        return checked(self._check, field, self._measured), hit

    def _closest(self, grid: Grid, layers: tuple[int, int] | None, known: Tensor | None = None) -> ClosestMap:
        found = closest_map(self._measured, self._structure, grid, layers, known=known)
        if self._repeated is None:
            return found
        found = found._replace(faces=self._repeated.faces(found.faces))
        if known is None:
            signed, ambiguous = self._repeated.signed_slab(found.values[None], grid, (layers or (0,))[0])
            found = found._replace(values=signed[0], ambiguous=ambiguous)
        return found

    def narrow_band(
        self,
        grid: BandGrid,
        *,
        half_width: float = 3.0,
        sign: Sign = "winding",
        hole_size: float | None = None,
    ) -> SparseSDM:
        """As `sdm.narrow_band`, on this index."""
        from sdm.engine.band.calls import band_grid, band_method, band_of

        method = band_method(half_width, sign, hole_size)
        return band_of(self, band_grid(self.mesh, grid, half_width=half_width), half_width, method)

    @overload
    def slabs(
        self,
        grid: GridLike,
        max_bytes: int = 1 << 28,
        *,
        ambiguous: Tensor | None = None,
        return_closest: Literal[False] = False,
        **options: Unpack[SignOptions],
    ) -> Iterator[tuple[int, int, Tensor]]: ...
    @overload
    def slabs(
        self,
        grid: GridLike,
        max_bytes: int = 1 << 28,
        *,
        ambiguous: Tensor | None = None,
        return_closest: Literal[True],
        **options: Unpack[SignOptions],
    ) -> Iterator[tuple[int, int, Tensor, Closest]]: ...
    def slabs(
        self,
        grid: GridLike,
        max_bytes: int = 1 << 28,
        *,
        ambiguous: Tensor | None = None,
        sign: Sign = "winding",
        hole_size: float | None = None,
        return_closest: bool = False,
    ) -> Iterator[tuple[int, int, Tensor]] | Iterator[tuple[int, int, Tensor, Closest]]:
        """The map of a grid, slab by slab: (begin, end, values (end - begin, ny, nz)) for ascending i.

        Args:
            grid: The whole grid, of any size, or voxels along each axis of one around the mesh.
            max_bytes: Most memory for one slab, which has a multiple of 32 layers; at least 32 are always taken.
            ambiguous: An integer tensor on the index's device, to which each slab's count of ambiguous voxels is added;
                a flood has none.
            sign: As for `sdm.signed_distance_map`. A flood goes through all of a grid at once, so that the whole map
                has to fit into memory.
            hole_size: Of a flood.
            return_closest: Also give each slab's closest points, as a fourth: 28 more bytes a voxel.

        The slabs together are what `signed_distance_map` gives: bit for bit, save where a mesh is so fine for the grid
        that lists of triangles outgrow their memory, and equally near triangles are then told apart in another order.
        Beyond a slab, workspace is used as by `sdm.signed_distance_map`.
        """
        if not isinstance(grid, Grid):
            grid = as_grid(grid, self.mesh)
        method = SignMethod(sign, hole_size)
        whole = None
        if sign == "flood":
            with memory_guard(2 * grid.nbytes, self.device, described(grid)):
                whole = self._by(method, grid).values
        bytes_of_voxel = VOXEL_BYTES if return_closest else 4
        check = None if self._check is None else SlabsCheck(self._measured, grid, sign)
        for begin, end in slabs_of(grid, min(max_bytes // bytes_of_voxel, LARGEST_SLAB)):
            if whole is not None:
                values, unclear = whole[begin:end], None
            elif sign == "none":
                values, unclear = self._unsigned_slab(grid, begin, end)[0], None
            else:
                several, unclear = self._slab(grid, begin, end)
                values = several[0]
            if check is not None:
                check.add(values)
            if ambiguous is not None and unclear is not None and not self.closed:
                ambiguous += unclear[0]
            if return_closest:
                hit = self._closest(grid, (begin, end), values.detach())
                at = Layers(grid, begin, end)
                yield begin, end, values, Closest(hit.points, hit.faces, hit.barycentric, self.mesh, at)
            else:
                yield begin, end, values
        if check is not None:
            check.end()

    def _slab(self, grid: Grid, begin: int, end: int) -> tuple[Tensor, Tensor]:
        mesh = self._measured
        found = map_slab(mesh.vertices[None], mesh.faces, self._structure, grid, begin, end)
        return found if self._repeated is None else self._repeated.signed_slab(found[0], grid, begin)

    def _unsigned_slab(self, grid: Grid, begin: int, end: int) -> Tensor:
        mesh = self._measured
        if is_eager(mesh.vertices):
            return structure_slab(self._structure, grid, begin, end, signed=False)[0]
        return map_slab(mesh.vertices[None], mesh.faces, self._structure, grid, begin, end)[0].abs()
