"""Exact signed distances to triangle meshes: the functions that most users call."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Literal, overload

import torch
from jaxtyping import Float32
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device, memory_guard
from sdm.core.grid import Grid, GridLike, as_grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.signed_distance_map import SDM
from sdm.engine.acceleration import AccelerationStructure, build
from sdm.engine.closest_points import Closest
from sdm.engine.map_check import MapCheck, checked, quiet
from sdm.engine.maps import LARGEST_SLAB, batch_maps, index_map, is_recordable, mesh_map, put_together, slabs_of
from sdm.engine.mesh_lists import are_meshes, box_of, grids_of
from sdm.engine.ops import map_slab, points_closest, points_distance, points_winding
from sdm.engine.repeated_faces import CROWDED, RepeatedFaces, repeated_faces
from sdm.errors import MeshError
from sdm.inspect import orient_outward
from sdm.topology.boundary_edges import boundary_edges

Orient = Literal["keep", "auto"]


class MeshIndex:
    """A mesh with its acceleration structure: built once, queried often.

    Args:
        mesh: The mesh, or whatever `as_mesh` takes for one: a path, (vertices, faces), a mesh of another library.
            Gradients flow to its vertices where they require them.
        device: `"cuda"`, `"cuda:1"`, `"cpu"`; by default the mesh's own if that is a GPU, else a GPU if there is
            one, else the CPU.
        orient: `"auto"` makes faces agree and turns parts that are inside out, see `sdm.inspect.orient_outward`;
            `"keep"` takes every mesh as it is.
        warn: Raise an `SDMWarning`, one at most, if a whole map is probably not what was meant.

    Raises:
        DeviceError: The device is not there.

    Takes about 350 bytes a triangle of memory on the device (420 for a mesh with more than 1024 boundary edges).
    Queries may run on any torch stream; between streams the caller orders the work, as for any tensor.
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
        _refuse_forward_mode(mesh.vertices)
        self.device = choose_device(device, mesh.vertices)
        self.mesh = _oriented(mesh, orient).to(self.device)
        self._check = MapCheck() if warn else None
        self._edges = boundary_edges(self.mesh.vertices, self.mesh.faces)
        self._build()

    def _build(self) -> None:
        mesh, edges = self.mesh, self._edges
        self._repeated: RepeatedFaces | None = None
        # Copies of triangles leave edges as often as they are there; if they close a surface, they have few vertices.
        if self.device.type == "cpu" and (
            len(mesh) >= CROWDED * mesh.vertices.shape[0]
            or (edges.shape[0] >= CROWDED and bool((edges[CROWDED - 1 :] == edges[: 1 - CROWDED]).all(1).any()))
        ):
            self._repeated = repeated_faces(mesh)
        if self._repeated is not None:
            mesh, edges = self._repeated.distinct, None
        self._measured = mesh
        self._structure = build(mesh.vertices.detach()[None], mesh.faces, edges)

    @property
    def closed(self) -> bool:
        """True if the mesh has no boundary, so that its winding number is a whole number everywhere."""
        return self._edges.shape[0] == 0

    def update(self, vertices: Any) -> None:
        """Move the vertices: `vertices` (V,3), in the order of the mesh's. The faces stay.

        Raises:
            MeshError: Another number of vertices, or a coordinate that is not finite.
        """
        moved = as_tensor(vertices, torch.float32, f"the vertices of {self.mesh.name}", device=self.device)
        if moved.shape != self.mesh.vertices.shape:
            raise MeshError(
                f"update was given vertices of shape {tuple(moved.shape)}, but {self.mesh.name} has "
                f"{tuple(self.mesh.vertices.shape)}; build a new MeshIndex for another mesh"
            )
        _refuse_forward_mode(moved)
        self.mesh = TriangleMesh(moved, self.mesh.faces, self.mesh.name)
        self._edges = boundary_edges(self.mesh.vertices, self.mesh.faces)
        self._build()

    @overload
    def signed_distance(self, points: Any, *, return_closest: Literal[False] = False) -> Tensor: ...
    @overload
    def signed_distance(self, points: Any, *, return_closest: Literal[True]) -> tuple[Tensor, Closest]: ...
    def signed_distance(self, points: Any, *, return_closest: bool = False) -> Tensor | tuple[Tensor, Closest]:
        """As `sdm.signed_distance`, on this index."""
        return _at_points(self._measured, points, return_closest, self._structure, self._repeated)

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
        """
        at = _as_points(points, self.device)
        if self._repeated is not None:
            return self._repeated.winding(at.reshape(-1, 3)).reshape(at.shape[:-1])
        values = points_winding(self.mesh.vertices, self.mesh.faces, at.reshape(-1, 3), self._structure)
        return values.reshape(at.shape[:-1])

    def signed_distance_map(self, grid: GridLike) -> SDM:
        """As `sdm.signed_distance_map`, on this index."""
        if not isinstance(grid, Grid):
            grid = as_grid(grid, self.mesh)
        with memory_guard(grid.nbytes, self.device, _described(grid)):
            if is_recordable(self.mesh.vertices, grid.nbytes + self._structure.nbytes):
                values, ambiguous = index_map(self._structure, grid)
                return checked(self._check, SDM(values, grid, 0 if self.closed else int(ambiguous)), self._measured)
            unclear = []

            def slabs() -> Iterator[tuple[int, int, Tensor]]:
                for begin, end in slabs_of(grid, LARGEST_SLAB):
                    values, ambiguous = self._slab(grid, begin, end)
                    unclear.append(ambiguous)
                    yield begin, end, values

            values = put_together(slabs(), grid.shape[0])[0]
        # Of a closed mesh it is known without a look at the device, which would wait for it.
        count = 0 if self.closed else sum(int(ambiguous) for ambiguous in unclear)
        return checked(self._check, SDM(values, grid, count), self._measured)

    def slabs(
        self, grid: GridLike, max_bytes: int = 1 << 28, *, ambiguous: Tensor | None = None
    ) -> Iterator[tuple[int, int, Tensor]]:
        """The map of a grid, slab by slab: (begin, end, values (end - begin, ny, nz)) for ascending i.

        Args:
            grid: The whole grid, of any size, or voxels along each axis of one around the mesh.
            max_bytes: Most memory for one slab, which has a multiple of 32 layers; at least 32 are always taken.
            ambiguous: An integer tensor on the index's device, to which each slab's count of ambiguous voxels is added.

        The slabs together are what `signed_distance_map` gives: bit for bit, save where a mesh is so fine for the grid
        that lists of triangles outgrow their memory, and equally near triangles are then told apart in another order.
        Beyond a slab, scratch memory is used as by `sdm.signed_distance_map`.
        """
        if not isinstance(grid, Grid):
            grid = as_grid(grid, self.mesh)
        for begin, end in slabs_of(grid, min(max_bytes // 4, LARGEST_SLAB)):
            values, unclear = self._slab(grid, begin, end)
            if ambiguous is not None and not self.closed:
                ambiguous += unclear[0]
            yield begin, end, values[0]

    def _slab(self, grid: Grid, begin: int, end: int) -> tuple[Tensor, Tensor]:
        mesh = self._measured
        found = map_slab(mesh.vertices[None], mesh.faces, self._structure, grid, begin, end)
        return found if self._repeated is None else self._repeated.signed_slab(found[0], grid, begin)


def signed_distance_map(
    mesh: MeshLike,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
    orient: Orient = "keep",
) -> SDM:
    """The exact signed distance map of a mesh on a grid.

    Args:
        mesh: Any triangles: closed or not, with slivers, zero-area and repeated faces. A `TriangleMesh`, to whose
            vertices gradients flow, or a path, (vertices, faces), or a mesh of trimesh, Open3D, PyVista or meshio.
        grid: The voxel centres to measure at, or voxels along each axis of a cube around the mesh.
        resolution: That number, by name.
        margin: Room around the mesh in that cube, as a share of the longest edge of the mesh's box; 0.05 by default.
        device: Where to compute; by default a GPU if there is one. The values stay there.
        orient: `"auto"` makes faces agree and turns parts that are inside out, see `sdm.inspect.orient_outward`;
            `"keep"` takes every mesh as it is.

    Returns:
        The map, negative inside: every value is the distance to the closest point over all triangles, to within
        4 roundings of float32 at the scale of the coordinates, with the sign of the generalised winding number
        (more than 0.5 is inside). Inside is not well defined for open sheets: `ambiguous_voxels` counts where the
        winding number is within 0.25 of 0.5.

    Raises:
        DeviceError: The device is not there.
        GridError: The map does not fit into memory, or nothing says what its grid is.
        MeshError: What is given is no mesh, or one that cannot be used.

    Warns:
        SDMWarning: The map is probably not what was meant: a mesh or a part of it inside out, faces that disagree, no
            volume, or a box outside the grid, as of LPS coordinates or another unit. On a GPU when something of the
            map is first read on the host; never for maps that gradients flow through.

    Memory beyond the map itself: about 350 bytes a triangle, and scratch: 100 MiB on a CPU, and up to 128 more where
    slices are thick (`sdm.engine.thick_slices`); on a GPU 150 to 600 MiB for meshes of up to 100,000 triangles, more
    for finer ones, at most a 14th of the GPU's memory and 4.5 GiB. Maps larger than memory: `MeshIndex.slabs`. On a GPU
    calls of one kind are recorded and replayed, which keeps some of that memory: see `sdm.runtime.graphs`.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, mesh, resolution, margin)
    where = choose_device(device, mesh.vertices)
    measured = _oriented(mesh, orient)
    mesh = measured.to(where)
    if is_recordable(mesh.vertices, grid.nbytes):
        _refuse_forward_mode(mesh.vertices)
        with memory_guard(grid.nbytes, mesh.device, _described(grid)):
            values, ambiguous = mesh_map(mesh.vertices, mesh.faces, grid)
        field = SDM(values, grid, 0 if ambiguous is None else int(ambiguous))
    else:
        index = MeshIndex(mesh, where, warn=False)
        field = index.signed_distance_map(grid)
        # Copies of a triangle are looked at once.
        measured = measured if index._repeated is None else index._measured
    return checked(MapCheck(), field, measured)


@overload
def signed_distance(
    mesh: MeshLike,
    points: Any,
    *,
    return_closest: Literal[False] = False,
    device: str | torch.device | None = None,
) -> Tensor: ...
@overload
def signed_distance(
    mesh: MeshLike, points: Any, *, return_closest: Literal[True], device: str | torch.device | None = None
) -> tuple[Tensor, Closest]: ...
def signed_distance(
    mesh: MeshLike, points: Any, *, return_closest: bool = False, device: str | torch.device | None = None
) -> Tensor | tuple[Tensor, Closest]:
    """Exact signed distances of points from a mesh.

    Args:
        mesh: Any triangles, as `signed_distance_map` takes them.
        points: (...,3) coordinates in the mesh's unit, NumPy or torch, taken as float32.
        return_closest: Also return where the closest points are.
        device: Where to compute; by default where the points are if they are a tensor, else a GPU if there is one.

    Returns:
        (...) float32, negative inside, as exact as `signed_distance_map`; NaN where a point is not finite.
        Differentiable in `points` and in `mesh.vertices`: the gradient at a point is the outward direction, at a vertex
        minus the closest point's barycentric coordinate times that direction. With `return_closest` also a `Closest`.
    """
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    _refuse_forward_mode(mesh.vertices)
    where = choose_device(device, points if isinstance(points, Tensor) else None, mesh.vertices)
    return _at_points(mesh.to(where), points, return_closest, None)


@overload
def signed_distance_maps(
    vertices: Sequence[MeshLike],
    faces: GridLike | Sequence[Grid] | None = None,
    /,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
) -> list[SDM]: ...
@overload
def signed_distance_maps(
    vertices: Any,
    faces: Any,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
) -> Float32[Tensor, "b nx ny nz"]: ...
def signed_distance_maps(
    vertices: Any,
    faces: Any = None,
    grid: GridLike | None = None,
    *,
    resolution: int | None = None,
    margin: float | None = None,
    device: str | torch.device | None = None,
) -> Float32[Tensor, "b nx ny nz"] | list[SDM]:
    """The exact signed distance maps of a batch of meshes: of ones that share their faces in one call.

    Args:
        vertices: (B,V,3) float32, one mesh each. Not checked for NaN: that would wait for the device.
        faces: (F,3) int32.
        grid: The voxel centres to measure at, the same for all, or voxels along each axis of a cube around all.
        resolution: That number, by name.
        margin: Room in that cube, as for `signed_distance_map`.
        device: Where to compute; by default where the vertices are if they are a tensor, else a GPU if there is one.

    Returns:
        (B,nx,ny,nz) float32, negative inside. Differentiable in `vertices`. Recorded and replayed as
        `signed_distance_map`.

    Meshes that differ: `signed_distance_maps([mesh, ...], grid)` with one grid, one for each mesh, or voxels along each
    axis of a cube around each, gives a list of maps, each that of `signed_distance_map`.
    """
    if not isinstance(grid, Grid) and are_meshes(vertices):
        grids = faces if grid is None else grid
        return _maps_of(vertices, grids, resolution=resolution, margin=margin, device=device)
    where = choose_device(device, vertices if isinstance(vertices, Tensor) else None)
    batch, shared = vertices, faces
    # A stream's are as they should be, batch after batch.
    if not (isinstance(batch, Tensor) and batch.dtype == torch.float32 and batch.device == where):
        batch = as_tensor(vertices, torch.float32, "the vertices", device=where)
    if not (isinstance(shared, Tensor) and shared.dtype == torch.int32 and shared.device == where):
        shared = as_tensor(faces, torch.int32, "the faces", device=where)
    _refuse_forward_mode(batch)
    if batch.ndim != 3 or batch.shape[2] != 3 or batch.shape[0] == 0:
        raise MeshError(f"the vertices have shape {tuple(batch.shape)}; (B, V, 3) is needed")
    if shared.ndim != 2 or shared.shape[1] != 3 or shared.shape[0] == 0:
        raise MeshError(f"the faces have shape {tuple(shared.shape)}; (F, 3) with F > 0 is needed")
    if not isinstance(grid, Grid) or resolution is not None or margin is not None:
        grid = as_grid(grid, box_of(batch, shared), resolution, margin)
    with memory_guard(4 * batch.shape[0] * math.prod(grid.shape), where, f"{batch.shape[0]} maps"):
        return batch_maps(batch, shared, grid, None)


def _maps_of(meshes: Sequence[MeshLike], grids: Any, **options: Any) -> list[SDM]:
    of_each = zip(meshes, grids_of(meshes, grids), strict=True)
    with quiet():
        return [signed_distance_map(mesh, grid, **options) for mesh, grid in of_each]


def _oriented(mesh: TriangleMesh, orient: Orient) -> TriangleMesh:
    if orient not in ("keep", "auto"):
        raise MeshError(f"orient is {orient!r}; use 'keep' or 'auto'")
    return orient_outward(mesh) if orient == "auto" else mesh


def _described(grid: Grid) -> str:
    return f"a map of {' x '.join(map(str, grid.shape))} voxels"


def _as_points(points: Any, device: torch.device) -> Tensor:
    at = as_tensor(points, torch.float32, "the points", device=device)
    if at.ndim == 0 or at.shape[-1] != 3:
        raise MeshError(f"the points have shape {tuple(at.shape)}; (..., 3) is needed")
    _refuse_forward_mode(at)
    return at


def _refuse_forward_mode(tensor: Tensor) -> None:
    # Torch would take the derivatives of operators like these for zero, without a word.
    if not torch.compiler.is_compiling() and unpack_dual(tensor).tangent is not None:
        raise NotImplementedError(
            "signed distances have derivatives in reverse mode alone: use backward() in place of jvp"
        )


def _at_points(
    mesh: TriangleMesh,
    points: Any,
    return_closest: bool,
    structure: AccelerationStructure | None,
    repeated: RepeatedFaces | None = None,
) -> Tensor | tuple[Tensor, Closest]:
    at = _as_points(points, mesh.device)
    shape, at = at.shape[:-1], at.reshape(-1, 3)
    if not return_closest and not (at.requires_grad or mesh.vertices.requires_grad):
        values = points_distance(mesh.vertices, mesh.faces, at, structure)
        return (values if repeated is None else repeated.signed(values, at)).reshape(shape)
    values, point, face, barycentric = points_closest(mesh.vertices, mesh.faces, at, structure)
    if repeated is not None:
        values, face = repeated.signed(values, at), repeated.faces(face)
    values = values.reshape(shape)
    if not return_closest:
        return values
    return values, Closest(point.reshape(*shape, 3), face.reshape(shape), barycentric.reshape(*shape, 3))
