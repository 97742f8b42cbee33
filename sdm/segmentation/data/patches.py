"""Batches of patches, cut, turned and scaled on the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from sdm.errors import SDMError
from sdm.losses import clipped_sdf
from sdm.runtime.torch_warp import to_device
from sdm.segmentation.data.augment import RANGES, Augment, Draw, draw
from sdm.segmentation.data.case import Case, standardized
from sdm.segmentation.data.downsample import coarse_image, coarse_map, whole_cubes
from sdm.segmentation.data.method_target import CLIP_VOXELS, distance_map
from sdm.segmentation.data.position_channels import position_frame, positions
from sdm.segmentation.train.methods import METHODS, Map
from sdm.segmentation.train.settings import Settings

Triple = tuple[int, int, int]

# Standard deviation of noise that is enlarged twice: along each axis a mean with weights 3/4 and 1/4.
GRAIN = (0.75**2 + 0.25**2) ** 1.5


@dataclass(frozen=True)
class Patch:
    """A batch on the device: image (B,1,x,y,z), with positions (B,4,x,y,z), and map (B,1,x,y,z) float32, label bool."""

    image: Tensor
    label: Tensor
    map: Tensor | None


class Patches:
    """All cases on the device, each with its distance map, and batches cut from them.

    The map is that of the whole case, made once. As published (`per_patch`) it is made anew of each patch's label, with
    voxels of size 1, so that its scale is another for every patch.

    Args:
        cases: With labels, all of one voxel size.
        kind: The map that the method wants, if any.
        size: Voxels of a patch along each axis. Smaller cases are padded by background.
        device: Where the cases are kept and the batches are made.
        per_patch: See above.
        mirrors: Along which axes patches may be mirrored: see `augment.draw`.
        position: Give the image three more channels: where in its case each voxel comes from, see `positions`.
        coarsen: Make voxels so many times as large first, see `coarse`; `spacing`, `size` and distances in voxels are
            then of these.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        kind: Map | None,
        size: Triple,
        device: torch.device | str,
        *,
        per_patch: bool = False,
        mirrors: str = "xyz",
        position: bool = False,
        coarsen: int = 1,
    ) -> None:
        self.kind: Map | None = kind
        self.size, self.device, self.per_patch = size, torch.device(device), per_patch
        self.mirrors, self.position, self.coarsen = mirrors, position, coarsen
        x, y, z = cases[0].spacing
        self.spacing = (coarsen * x, coarsen * y, coarsen * z)
        self._shapes: list[torch.Size] = []
        self._cases = [self._stack(case) for case in cases]

    @classmethod
    def of_settings(cls, cases: Sequence[Case], settings: Settings, device: torch.device | str) -> Patches:
        """Patches for a training with these settings."""
        return cls(
            cases,
            METHODS[settings.method].map,
            settings.patch,
            device,
            per_patch=settings.targets == "patch",
            mirrors=settings.mirrors,
            position=settings.position,
            coarsen=settings.coarsen,
        )

    def _stack(self, case: Case) -> Tensor:
        if case.label is None:
            raise SDMError(f"{case.name} has no label")
        image = standardized(coarse_image(case.image.to(self.device), self.coarsen))
        self._shapes.append(image.shape)
        room = [max(0, n - m) for n, m in zip(self.size, image.shape, strict=True)]
        pad = [x for r in reversed(room) for x in (r // 2, r - r // 2)]
        image = functional.pad(image, pad, value=float(image.min()))
        # Padded before its map is made: distances go on beyond the volume.
        label = whole_cubes(case.label.to(self.device).float(), self.coarsen)
        label = functional.pad(label, [self.coarsen * x for x in pad])
        channels = [image, coarse_image(label, self.coarsen)]
        if self.kind is not None and not self.per_patch:
            # A patch that is scaled scales its distances, so they are clipped afterwards.
            whole: Map = "signed" if self.kind == "clipped" else self.kind
            channels.append(self._case_map(case, label, whole))
        return torch.stack(channels)

    def _case_map(self, case: Case, label: Tensor, kind: Map) -> Tensor:
        """Map of a whole case at its larger voxels, from the padded label of its own voxels."""
        return coarse_map(distance_map(label[None, None], kind, case.spacing)[0, 0], self.coarsen)

    def __len__(self) -> int:
        return len(self._cases)

    def batch(self, count: int, *, seed: int, step: int, augment: Augment = "affine") -> Patch:
        """A batch of `count` patches: a pure function of (seed, step), whatever came before."""
        draws = [draw(seed, step, row, len(self), augment, mirrors=self.mirrors) for row in range(count)]
        places = [self._place(d) for d in draws]
        frames = self._there(torch.stack([self._frame(d, *place) for d, place in zip(draws, places, strict=True)]))
        volumes = torch.cat([self._cut(d, frame) for d, frame in zip(draws, frames, strict=True)])
        image, label = volumes[:, :1], volumes[:, 1:2] > 0.5
        if augment in RANGES:
            image = self._intensities(image, draws, augment)
        if self.position:
            image = torch.cat([image, self._positions(draws, places)], 1)
        return Patch(image, label, self._map(volumes, label, draws))

    def _map(self, volumes: Tensor, label: Tensor, draws: Sequence[Draw]) -> Tensor | None:
        if self.kind is None:
            return None
        if self.per_patch:
            return distance_map(label, self.kind, published=True)
        values = volumes[:, 2:3]
        if self.kind in ("signed", "clipped"):
            # One voxel of the patch is `scale` voxels of the case.
            values = values / self._there(torch.tensor([d.scale for d in draws], device="cpu")).view(-1, 1, 1, 1, 1)
        return clipped_sdf(values, CLIP_VOXELS * max(self.spacing)) if self.kind == "clipped" else values

    def _there(self, values: Tensor) -> Tensor:
        """Small numbers of the host on the device, without waiting for what is under way there."""
        return to_device(values.to(torch.float32), self.device)

    def _place(self, d: Draw) -> tuple[Tensor, Tensor]:
        """Place in the padded case: (3,3) from offsets in the patch's voxels to those of the case, and the centre."""
        shape = torch.tensor(self._cases[d.case].shape[1:], dtype=torch.float64, device="cpu")
        size = torch.tensor(self.size, dtype=torch.float64, device="cpu")
        # Whole voxels, so that a patch that is not turned is a copy.
        centre = torch.floor(d.place * (shape - size + 1)) + (size - 1) / 2
        spacing = torch.tensor(self.spacing, dtype=torch.float64, device="cpu")
        # Turns are rigid in mm, not in voxels.
        return d.scale * d.turn * spacing[None] / spacing[:, None], centre

    def _frame(self, d: Draw, matrix: Tensor, centre: Tensor) -> Tensor:
        """(3,4): the place in the terms of `affine_grid`."""
        last = (torch.tensor(self._cases[d.case].shape[1:], dtype=torch.float64, device="cpu") - 1).clamp(min=1)
        size = torch.tensor(self.size, dtype=torch.float64, device="cpu")
        normal = (2 / last)[:, None] * matrix * ((size - 1) / 2)[None]
        offset = 2 * centre / last - 1
        # affine_grid counts the axes from the last.
        return torch.cat([normal.flip(0, 1), offset.flip(0)[:, None]], 1)

    def _positions(self, draws: Sequence[Draw], places: Sequence[tuple[Tensor, Tensor]]) -> Tensor:
        """(B,3,x,y,z)."""
        frames = []
        for d, (matrix, centre) in zip(draws, places, strict=True):
            shape = self._shapes[d.case]
            pad = [(n - m) // 2 for n, m in zip(self._cases[d.case].shape[1:], shape, strict=True)]
            frames.append(position_frame(matrix, centre - torch.tensor(pad, device="cpu"), self.size, shape))
        return positions(self._there(torch.stack(frames)), self.size)

    def _cut(self, d: Draw, frame: Tensor) -> Tensor:
        points = functional.affine_grid(frame[None], [1, 1, *self.size], align_corners=True)
        return functional.grid_sample(self._volume(d)[None], points, padding_mode="border", align_corners=True)

    def _volume(self, d: Draw) -> Tensor:
        """Channels (C,x,y,z) of a draw's case: image, share of foreground and map."""
        return self._cases[d.case]

    def _intensities(self, image: Tensor, draws: Sequence[Draw], augment: Augment) -> Tensor:
        random = torch.Generator(self.device).manual_seed(draws[0].seed)
        # One transfer for all numbers, (B,1,1,1,1) each.
        drawn = self._there(
            torch.tensor([[d.gain, d.shift, d.noise, d.gamma, d.shading, d.blur] for d in draws], device="cpu")
        )
        gain, shift, deviation, gamma, shading, blur = drawn.T.reshape(6, -1, 1, 1, 1, 1)
        noise = _noise(image, random, coarse=augment == "scanner")
        if augment != "affine":
            shade = torch.randn((len(draws), 1, 4, 4, 4), generator=random, device=self.device, dtype=image.dtype)
            image = _as_if_by_another_scanner(image, gamma, (shading * shade).exp(), blur)
        return image * gain + shift + deviation * noise


def _noise(image: Tensor, random: torch.Generator, *, coarse: bool) -> Tensor:
    """Noise of standard deviation 1, from voxel to voxel or, as in enlarged scans, over two."""
    if not coarse:
        return torch.randn(image.shape, generator=random, device=image.device, dtype=image.dtype)
    half = [(n + 1) // 2 for n in image.shape[2:]]
    grain = torch.randn((*image.shape[:2], *half), generator=random, device=image.device, dtype=image.dtype)
    fine = functional.interpolate(grain, [2 * n for n in half], mode="trilinear", align_corners=False)
    x, y, z = image.shape[2:]
    return fine[..., :x, :y, :z] / GRAIN


def _as_if_by_another_scanner(image: Tensor, gamma: Tensor, shade: Tensor, blur: Tensor) -> Tensor:
    """Images (B,1,x,y,z) of another contrast, coil and sharpness, of their own mean and deviation.

    Args:
        image: Of any scale.
        gamma: (B,1,1,1,1) exponents.
        shade: (B,1,n,n,n) factors on a coarse grid.
        blur: (B,1,1,1,1) in 0..1: the share of the mean over 3^3 voxels.
    """
    axes = (1, 2, 3, 4)
    mean, deviation = image.mean(axes, keepdim=True), image.std(axes, keepdim=True)
    low = image.amin(axes, keepdim=True)
    width = (image.amax(axes, keepdim=True) - low).clamp_min(1e-6)
    value = ((image - low) / width).pow(gamma)
    value = value * functional.interpolate(shade, image.shape[2:], mode="trilinear", align_corners=True)
    value = torch.lerp(value, functional.avg_pool3d(value, 3, 1, 1, count_include_pad=False), blur)
    change = deviation / value.std(axes, keepdim=True).clamp_min(1e-6)
    return mean + change * (value - value.mean(axes, keepdim=True))
