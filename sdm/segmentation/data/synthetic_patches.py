"""Patches of synthetic cases beside real ones: labelled images warped to shapes of which only a label is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.random import generator
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.engine.many import signed_distance_maps
from sdm.errors import SDMError
from sdm.segmentation.data.augment import Draw
from sdm.segmentation.data.case import Case
from sdm.segmentation.data.downsample import coarse_map, whole_cubes
from sdm.segmentation.data.method_target import distance_map, map_of_distances
from sdm.segmentation.data.patches import Patches, Triple
from sdm.segmentation.data.shape_warps import displacement, enlarged, moved, warped
from sdm.segmentation.train.methods import METHODS, Map
from sdm.segmentation.train.settings import Settings

# Edge, in voxels of the cases, of the voxels on which displacements are looked for: they are smooth.
WARP_VOXELS = 4
# Background around a label, in voxels of a patch, so that its surface is closed.
ROOM = 2
# Least and greatest part of the way to a shape; a second shape pulls by less than half.
WAY = (0.3, 1.0)
SECOND = 0.5


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface of a label in mm, from the centre of its foreground: vertices (V,3), faces (F,3) on the device."""

    vertices: Tensor
    faces: Tensor
    # Of the foreground, in mm, where voxel (0,0,0) of the larger voxels has its centre at the origin.
    centre: Tensor


class SyntheticPatches(Patches):
    """Patches of which a share is of synthetic cases, made anew for each patch on the device.

    A synthetic case is a labelled one, drawn at random, whose image is warped smoothly so that its organ comes nearer
    to a shape of which only the label is known, some of the way, and some of the way to a second one. Its own surface
    is warped with it, and the exact distances from that are its map and its label. So what surrounds the organ is real,
    and label, map and image belong together to a fraction of a voxel, however well the shapes meet. In half of them
    the organ has the brightness and contrast of another case's, to a random part.

    Args:
        cases: With labels, all of one voxel size.
        kind: The map that the method wants, if any.
        size: Voxels of a patch along each axis.
        device: Where all is kept and made.
        shapes: Labels (x,y,z) of other shapes of the organ, bool, of the cases' voxel size, that lie about as theirs.
        share: Of patches that are synthetic, 0 to 1.
        options: As for `Patches`.

    Which displacement carries a case to a shape is found when it is first needed, and kept. Everything is a pure
    function of (seed, step).

    Raises:
        SDMError: There are no shapes, or one is empty or full.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        kind: Map | None,
        size: Triple,
        device: torch.device | str,
        *,
        shapes: Sequence[Tensor],
        share: float = 0.5,
        per_patch: bool = False,
        mirrors: str = "xyz",
        position: bool = False,
        coarsen: int = 1,
    ) -> None:
        super().__init__(
            cases, kind, size, device, per_patch=per_patch, mirrors=mirrors, position=position, coarsen=coarsen
        )
        if not shapes:
            raise SDMError("synthetic patches need shapes: give labels of other cases, which need no images")
        self.share = share
        self._fine = cases[0].spacing
        self._grids = [Grid((0.0, 0.0, 0.0), self.spacing, stack.shape[1:]) for stack in self._cases]
        self._own = [self._surface(case.label, case.name) for case in cases if case.label is not None]
        self._shapes_only = [self._surface(shape, f"shape {n}") for n, shape in enumerate(shapes)]
        self._corners = [self._corner(n) for n in range(len(cases))]
        self._brightness = torch.stack([_brightness(stack) for stack in self._cases])
        self._factor = max(1, round(WARP_VOXELS / coarsen))
        self._signed: dict[int, Tensor] = {}
        # By case and shape; of the same cases and shapes one for several of these.
        self.warps: dict[tuple[int, int], Tensor] = {}

    @classmethod
    def of_settings_and_shapes(
        cls, cases: Sequence[Case], settings: Settings, device: torch.device | str, shapes: Sequence[Tensor]
    ) -> SyntheticPatches:
        """Patches for a training with these settings, a share `settings.synthetic` of them synthetic."""
        return cls(
            cases,
            METHODS[settings.method].map,
            settings.patch,
            device,
            shapes=shapes,
            share=settings.synthetic,
            per_patch=settings.targets == "patch",
            mirrors=settings.mirrors,
            position=settings.position,
            coarsen=settings.coarsen,
        )

    def _volume(self, d: Draw) -> Tensor:
        """The case of a draw, or a synthetic one."""
        random = generator(d.seed, "synthetic case")
        use, way, second, mix, bright = torch.rand(5, generator=random, dtype=torch.float64, device="cpu").tolist()
        if use >= self.share:
            return self._cases[d.case]
        first, other = torch.randint(len(self._shapes_only), (2,), generator=random, device="cpu").tolist()
        as_case = int(torch.randint(len(self), (1,), generator=random, device="cpu"))
        way = WAY[0] + (WAY[1] - WAY[0]) * way
        second *= SECOND
        u = way * ((1 - second) * self._warp(d.case, first) + second * self._warp(d.case, other))
        return self.synthetic(d.case, u, as_case, 2 * mix * (bright < 0.5))

    def synthetic(self, number: int, u: Tensor, as_case: int = 0, mix: float = 0.0) -> Tensor:
        """A synthetic case: image, share of foreground and map, as the case's own channels (C,x,y,z).

        Args:
            number: Of the case.
            u: (3,x',y',z'), how it is warped, on the larger voxels.
            as_case: Of the case whose organ's brightness and contrast it takes on.
            mix: To which part, 0 to 1.
        """
        stack, grid = self._cases[number], self._grids[number]
        u = enlarged(u.float(), self._factor, grid.shape)
        image = warped(stack[:1], u)
        spacing = self._there(torch.tensor(self.spacing, device="cpu"))
        own = self._own[number]
        # The surface in the stack's voxels, warped, and back in mm.
        vertices = moved((own.vertices + own.centre + self._corners[number]) / spacing, u) * spacing
        distances = signed_distance_maps(vertices[None].contiguous(), own.faces, grid, device=self.device)
        within = (0.5 - distances / min(self.spacing)).clamp(0, 1)
        mean, deviation = self._brightness[number]
        like = (image - mean) / deviation * self._brightness[as_case, 1] + self._brightness[as_case, 0]
        image = image + min(1.0, mix) * within * (like - image)
        channels = [image, within]
        if self.kind is not None and not self.per_patch:
            channels.append(map_of_distances(distances, self.kind))
        return torch.cat(channels)

    def _warp(self, number: int, shape: int) -> Tensor:
        """Displacement (3,x',y',z') float16 of a case to a shape, on the larger voxels."""
        key = (number, shape)
        if key not in self.warps:
            moving = self._coarse(number, self._own[number])
            self.warps[key] = displacement(moving, self._coarse(number, self._shapes_only[shape])).half()
        return self.warps[key]

    def _coarse(self, number: int, surface: Surface) -> Tensor:
        """Distances (x',y',z') of a surface at a case's place, on the larger voxels and in these."""
        own = surface is self._own[number]
        if own and number in self._signed:
            return self._signed[number]
        # A shape lies where the case's organ is.
        vertices = surface.vertices + self._own[number].centre + self._corners[number]
        mesh = TriangleMesh(vertices.contiguous(), surface.faces, check=False)
        field = signed_distance_map(mesh, self._grids[number], device=self.device).values
        coarse = coarse_map(field, self._factor) / (self._factor * min(self.spacing))
        if own:
            self._signed[number] = coarse
        return coarse

    def _surface(self, label: Tensor, name: str) -> Surface:
        """The surface of a label between its voxels, at those of a patch."""
        inside = label.to(self.device)
        if not bool(inside.any()) or bool(inside.all()):
            raise SDMError(f"{name} has no foreground or no background, so it has no surface")
        room = ROOM * self.coarsen
        around = functional.pad(whole_cubes(inside.float(), self.coarsen), (room,) * 6)
        field = coarse_map(distance_map(around[None, None], "signed", self._fine)[0, 0], self.coarsen)
        spacing = torch.tensor(self.spacing, device="cpu")
        origin = (-ROOM * spacing).tolist()
        mesh = SDM(field, Grid(tuple(origin), self.spacing, field.shape)).to_mesh()
        places = (field < 0).nonzero().double().mean(0)
        centre = (places * spacing.to(places) - ROOM * spacing.to(places)).float()
        return Surface(mesh.vertices - centre, mesh.faces, centre)

    def _corner(self, number: int) -> Tensor:
        """Place of a case's first voxel in its stack, in mm: smaller cases are padded."""
        room = [(n - m) // 2 for n, m in zip(self._cases[number].shape[1:], self._shapes[number], strict=True)]
        return self._there(torch.tensor(room, device="cpu") * torch.tensor(self.spacing, device="cpu"))


def _brightness(stack: Tensor) -> Tensor:
    """Mean and standard deviation (2,) of an image where its label is."""
    weight = (stack[1] > 0.5).float()
    mean = (stack[0] * weight).sum() / weight.sum().clamp_min(1)
    deviation = ((stack[0] - mean).square() * weight).sum() / weight.sum().clamp_min(1)
    return torch.stack([mean, deviation.sqrt().clamp_min(1e-3)])
