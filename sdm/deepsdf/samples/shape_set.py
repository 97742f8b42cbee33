"""Shape set: many shapes as one scene on the device, so that samples of a whole batch are one launch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.core.random import derive_seed
from sdm.deepsdf.samples.distribution import REACH, SampleDistribution
from sdm.deepsdf.samples.sample_source import Samples
from sdm.deepsdf.samples.unit_sphere import UnitSphere
from sdm.deepsdf.samples.usable_shapes import why_unusable
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError, SDMError
from sdm.inspect import orient_outward
from sdm.kernels.shapes.surface_samples import Law, Scene, draw
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.sampling.surface_points import triangle_areas

# Samples, which reach to REACH along each axis, are at most sqrt(3) REACH + 1 from their own shape. With this step
# between the centres they are at least sqrt((STEP - REACH)^2 + 2 REACH^2) - 1, which is more, from any other.
STEP = 6.0


class ShapeSet:
    """Exact samples of many closed meshes, normalised and laid out in one scene with room between them.

    Args:
        meshes: Closed meshes, each in its own unit. One that is inside out as a whole is turned, so that values are
            negative within every shape; faces keep their order.
        device: Where to compute; by default a GPU if there is one.
        spheres: The normalisation of each mesh; its own unit sphere if not given.
        distribution: Where samples are.
        skip_bad: Go on without the meshes that cannot be used; `rejected` lists them.

    Attributes:
        rejected: (name, reason) of each mesh that was left out.

    A query finds the nearest triangle of the scene, which is one of the point's own shape; rays along x meet at most
    every fourth layer of shapes. The normalised vertices are rounded to what float32 holds at their place in the scene
    (at most 2^-18 of the radius for up to 4,000 shapes), and so are the sampled points: distances between the two are
    then as exact as the engine's. `mesh(i)` is the shape that is measured.

    Raises:
        MeshError: No meshes, or one that is not closed.
    """

    def __init__(
        self,
        meshes: Sequence[TriangleMesh],
        device: str | torch.device | None = None,
        *,
        spheres: Sequence[UnitSphere] | None = None,
        distribution: SampleDistribution | None = None,
        skip_bad: bool = False,
    ) -> None:
        if not meshes:
            raise MeshError("there are no meshes to sample; give one or more")
        if spheres is not None and len(spheres) != len(meshes):
            raise MeshError(f"{len(spheres)} spheres were given for {len(meshes)} meshes; give one for each")
        self.rejected: tuple[tuple[str, str], ...] = ()
        if skip_bad:
            reasons = [why_unusable(mesh) for mesh in meshes]
            self.rejected = tuple((m.name, why) for m, why in zip(meshes, reasons, strict=True) if why is not None)
            good = [n for n, why in enumerate(reasons) if why is None]
            meshes = [meshes[n] for n in good]
            spheres = None if spheres is None else [spheres[n] for n in good]
            if not meshes:
                name, why = self.rejected[0]
                raise MeshError(f"none of {len(reasons)} meshes can be sampled; of the first, {name}, {why}")
        self.device = choose_device(device)
        self.distribution = distribution or SampleDistribution()
        self.names = tuple(m.name for m in meshes)
        self.spheres = tuple(UnitSphere.of(m) for m in meshes) if spheres is None else tuple(spheres)
        places = _places(len(meshes))
        self._places, self._cube = places.to(self.device), _cube_around(places)
        vertices, faces, count = [], [], 0
        for mesh, sphere, place in zip(meshes, self.spheres, self._places, strict=True):
            unit = sphere.to_unit(mesh.vertices.detach().to(self.device))
            # Of the vertices that faces use, as for the sphere: others are no part of the shape.
            if float(unit[mesh.faces.to(self.device).unique().long()].norm(dim=1).max()) > 1 + 1e-5:
                raise MeshError(f"{mesh.name} reaches out of its unit sphere; give a larger radius")
            vertices.append(unit + place)
            # The mesh, not the scene: the volumes of the others would hide that one is inside out.
            faces.append(orient_outward(mesh.to(self.device)).faces + count)
            count += len(unit)
        self._first_vertex = torch.tensor([0, *(len(v) for v in vertices)], device="cpu").cumsum(0).tolist()
        self._first_face = torch.tensor([0, *(len(f) for f in faces)], device="cpu").cumsum(0).tolist()
        scene = TriangleMesh(torch.cat(vertices), torch.cat(faces), "the shapes", check=False)
        self._index = MeshIndex(scene, self.device)
        if not self._index.closed:
            raise MeshError(
                f"{self._first_open()} is not closed, so its inside is not defined: close its holes first; "
                "skip_bad=True (--skip-bad) goes on without it"
            )
        corners = scene.vertices[scene.faces.long()]
        self._corners = corners.reshape(-1, 3)
        # On the host: a GPU adds up in another order each time.
        areas = triangle_areas(corners).cpu().cumsum(0).to(self.device)
        ends = torch.tensor(self._first_face, device=self.device)
        bounds = torch.cat([areas.new_zeros(1), areas])[ends]
        self._last_face = ends[1:] - 1
        self._areas, self._area_before, self._area_size = areas, bounds[:-1].contiguous(), bounds.diff()
        self._scene = self._as_scene()

    def __len__(self) -> int:
        return len(self.names)

    def mesh(self, shape: int) -> TriangleMesh:
        """The normalised mesh that the values of `shape` belong to."""
        mesh = self._index.mesh
        vertices = mesh.vertices[self._first_vertex[shape] : self._first_vertex[shape + 1]] - self._places[shape]
        faces = mesh.faces[self._first_face[shape] : self._first_face[shape + 1]] - self._first_vertex[shape]
        return TriangleMesh(vertices, faces, self.names[shape], check=False)

    def sample(self, shapes: Tensor, points: int, *, seed: int = 0, step: int = 0) -> Samples:
        """Fresh samples with exact signed distances, on the device; nothing waits for it.

        Args:
            shapes: (B,) int64 numbers of shapes on the device. On a CPU each must be there; on a GPU, where a look at
                them would wait, a number out of range is taken for the nearest one that is there.
            points: Samples of each shape.
            seed: Any whole number.
            step: Number of the training step.

        Returns:
            Points (B,points,3) and values (B,points): a pure function of (seed, step, shape, points), whatever the
            batch. Surface points are stratified: one in each of equal parts of the area, in the order of the faces.

        Raises:
            SDMError: On a CPU, a number of a shape that is not there.
        """
        law = Law()
        law.near = self.distribution.near_count(points)
        law.wide, law.tight = map(math.sqrt, self.distribution.variances)
        law.box, law.reach = self.distribution.box, REACH
        in_scene = torch.empty(len(shapes), points, 3, dtype=torch.float32, device=self.device)
        own = torch.empty_like(in_scene)
        chosen = self._in_range(shapes).contiguous()
        with on_current_stream(in_scene, chosen, *self._tables()):
            draw(
                self._scene,
                law,
                derive_seed(seed, "samples of shapes", points),
                step * len(self),
                as_warp(chosen, wp.int64),
                points,
                as_warp(in_scene.view(-1, 3), wp.vec3),
                as_warp(own.view(-1, 3), wp.vec3),
            )
        values = self._index.distances_in(self._cube, in_scene.view(-1, 3))
        return Samples(own, values.view(own.shape[:2]))

    def _in_range(self, shapes: Tensor) -> Tensor:
        """Numbers of shapes, int64, none of which reads other memory; see `sample`."""
        numbers = shapes.to(torch.int64)
        if numbers.device.type != "cpu":
            return numbers.clamp(0, len(self) - 1)
        wrong = numbers[(numbers < 0) | (numbers >= len(self))]
        if len(wrong):
            raise SDMError(f"shape {int(wrong[0])} is not there: the set has {len(self)}, numbered from 0")
        return numbers

    def _tables(self) -> tuple[Tensor, ...]:
        return self._places, self._corners, self._areas, self._area_before, self._area_size, self._last_face

    def _as_scene(self) -> Any:
        """The kernels' view of the shapes, whose memory stays this object's."""
        places, corners, areas, before, size, last = self._tables()
        scene = Scene()
        scene.places = as_warp(places, wp.vec3)
        scene.corners = as_warp(corners, wp.vec3)
        scene.areas = as_warp(areas, wp.float64)
        scene.area_before = as_warp(before, wp.float64)
        scene.area_size = as_warp(size, wp.float64)
        scene.last_face = as_warp(last, wp.int64)
        return scene

    def signed_distance(self, shapes: Tensor, points: Tensor) -> Tensor:
        """Exact signed distances (B,N) of points (B,N,3) of [-1.5,1.5]^3 from shapes (B,), in unit-sphere radii.

        A point is first rounded as the vertices are. NaN for points further out or not finite. Numbers of shapes are
        as for `sample`.
        """
        centre = self._places[self._in_range(shapes), None]
        values = self._index.signed_distance(points.to(self.device) + centre)
        return values.masked_fill((points.abs().amax(-1) > REACH).to(self.device), math.nan)

    def _first_open(self) -> str:
        for shape, name in enumerate(self.names):
            if not MeshIndex(self.mesh(shape), self.device).closed:
                return name
        return "one of the meshes"


def _places(count: int) -> Tensor:
    """Centres (count,3) of the shapes: a cubic lattice whose layers along x are staggered, so that rays pass."""
    side = max(1, math.ceil(round(count ** (1 / 3), 6)))
    number = torch.arange(count, device="cpu")
    layer = number // (side * side)
    row, column = number % (side * side) // side, number % side
    y = row * STEP + layer % 2 * (STEP / 2)
    z = column * STEP + layer // 2 % 2 * (STEP / 2)
    middle = math.floor(side / 2) * STEP
    return torch.stack([layer * STEP, y, z], 1).float() - middle


def _cube_around(places: Tensor) -> list[float]:
    """The least x, y and z and the edge of a cube around all samples.

    Halved again and again it has one shape's samples in each part: centres are half a STEP apart or more along each
    axis that tells them apart, and samples reach no further than half of that.
    """
    low = places.amin(0) - REACH
    cells = float((places.amax(0) + REACH - low).max()) / (STEP / 2)
    return [*low.tolist(), STEP / 2 * 2.0 ** max(0, math.ceil(math.log2(cells)))]
