"""The distance transform's passes over masks and classes in chunks, and the torch operators of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.kernels.edt import class_transform, transform
from sdm.runtime.operators import define
from sdm.runtime.torch_warp import as_warp, on_current_stream

# Kernels count the voxels of a launch in 32 bits, and a GPU uses 32 threads a row.
MOST_VOXELS = (1 << 31) - 1
LANES = 32
# Voxels of all volumes that go through the passes together on a GPU: their scratch takes 4 bytes each.
TOGETHER = 1 << 28
# Classes that one byte tells apart, beside what is none.
MOST_KINDS = 255
# On a GPU, lines of all classes below which a thread each leaves it idle.
FEWEST_LINES = 1 << 16


def _fake_masks(mask: Tensor, spacing: Sequence[float], half: float, signed: bool, missing: float) -> Tensor:
    return torch.empty(mask.shape, dtype=torch.float32, device=mask.device)


@define("euclidean_distance_transform", _fake_masks)
def transform_masks(mask: Tensor, spacing: Sequence[float], half: float, signed: bool, missing: float) -> Tensor:
    """Distances (B,nx,ny,nz) float32 from bool (B,nx,ny,nz); see `sdm.euclidean_distance_transform`."""
    mask = mask.contiguous()
    out = torch.empty(mask.shape, dtype=torch.float32, device=mask.device)
    count = mask.shape[0]
    # One by one on a CPU, where a volume fills the cores.
    chunk = 1 if mask.device.type == "cpu" else max(1, min(count, MOST_VOXELS // _largest(mask)))
    for begin in range(0, count, chunk):
        _fill(mask[begin : begin + chunk], spacing, half, signed, missing, out[begin : begin + chunk])
    return out


def _fake_classes(
    labels: Tensor, classes: Sequence[int], spacing: Sequence[float], half: float, signed: bool, missing: float
) -> Tensor:
    shape = labels.shape[0], len(classes), *labels.shape[1:]
    return torch.empty(shape, dtype=torch.float32, device=labels.device)


@define("euclidean_distance_transforms", _fake_classes)
def transform_classes(
    labels: Tensor, classes: Sequence[int], spacing: Sequence[float], half: float, signed: bool, missing: float
) -> Tensor:
    """Distances (B,C,nx,ny,nz) float32 from each class of labels (B,nx,ny,nz), bit for bit those from its mask."""
    out = _fake_classes(labels, classes, spacing, half, signed, missing)
    fill_classes(labels, classes, spacing, half, signed, missing, out)
    return out


def fill_classes(
    labels: Tensor,
    classes: Sequence[int],
    spacing: Sequence[float],
    half: float,
    signed: bool,
    missing: float,
    out: Tensor,
) -> None:
    """As `transform_classes`, into `out`, which is contiguous. No masks of all classes are ever there at once."""
    kinds, largest = len(classes), _largest(labels)
    if kinds > MOST_KINDS:
        for begin in range(0, kinds, MOST_KINDS):
            part = _fake_classes(labels, classes[begin : begin + MOST_KINDS], spacing, half, signed, missing)
            fill_classes(labels, classes[begin : begin + MOST_KINDS], spacing, half, signed, missing, part)
            out[:, begin : begin + MOST_KINDS] = part
        return
    lines = kinds * labels[0].numel() // max(labels.shape[1:])
    if labels.device.type == "cuda" and lines < FEWEST_LINES:
        # Too few lines for a thread each.
        for number, volume in enumerate(labels):
            mask = torch.stack([is_class(volume, value) for value in classes])
            _fill(mask, spacing, half, signed, missing, out[number])
        return
    chunk = max(1, min(kinds, TOGETHER // largest, MOST_VOXELS // largest))
    for number, volume in enumerate(labels):
        _fill_kinds(*_named(volume, classes), spacing, half, signed, missing, chunk, out[number])


def _named(labels: Tensor, classes: Sequence[int]) -> tuple[Tensor, int]:
    """Labels (nx,ny,nz) uint8 and the value that the first class has in them; the others' follow."""
    if labels.dtype in (torch.uint8, torch.bool) and list(classes) == list(
        range(classes[0], classes[0] + len(classes))
    ):
        return labels.contiguous().view(torch.uint8), classes[0]
    named = torch.zeros(labels.shape, dtype=torch.uint8, device=labels.device)
    for number, value in enumerate(classes, 1):
        named.masked_fill_(is_class(labels, value), number)
    return named, 1


def _fill_kinds(
    labels: Tensor,
    value: int,
    spacing: Sequence[float],
    half: float,
    signed: bool,
    missing: float,
    chunk: int,
    out: Tensor,
) -> None:
    """Distances of the classes from `value` on, of labels (nx,ny,nz) uint8, into `out` (C,nx,ny,nz), by chunks."""
    nx, ny, nz = labels.shape
    device, sizes = labels.device, (float(spacing[0]), float(spacing[1]), float(spacing[2]))
    voxels = nx * ny * nz
    between = torch.empty(chunk * voxels, dtype=torch.float32, device=device)
    own = torch.empty(voxels if signed else 0, dtype=torch.float32, device=device)
    kinds = out.shape[0]
    counts = kinds * nx * ny, 2 * kinds * nx, 2 * kinds
    row_has, row_ends, slice_ends = torch.zeros(sum(counts), dtype=torch.int32, device=device).split(counts)

    def ends_from(kind: int) -> tuple[wp.array, wp.array, wp.array]:
        # Of the classes from this one on.
        rows, slices = row_has[kind * nx * ny :], row_ends[2 * kind * nx :]
        return as_warp(rows, wp.int32), as_warp(slices, wp.int32), as_warp(slice_ends[2 * kind :], wp.int32)

    with on_current_stream(labels, labels):
        source, inside = as_warp(labels.view(-1), wp.uint8), as_warp(own, wp.float32)
        # Kernels count the voxels of their results in 32 bits.
        for begin, end in _parts(kinds, max(1, min(MOST_KINDS, MOST_VOXELS // voxels))):
            shape, found = (end - begin, nx, ny, nz), as_warp(out[begin:end].view(-1), wp.float32)
            class_transform.find_rows(source, value + begin, shape, sizes, half, *ends_from(begin), found)
        if signed:
            room = as_warp(between[:voxels], wp.float32)
            ends = ends_from(0)[1:]
            class_transform.own_distances(source, value, kinds, (nx, ny, nz), sizes, half, missing, *ends, room, inside)
        for begin, end in _parts(kinds, chunk):
            class_transform.transform_classes(
                (end - begin, nx, ny, nz),
                sizes,
                half,
                signed,
                missing,
                inside,
                *ends_from(begin),
                as_warp(between, wp.float32),
                as_warp(out[begin:end].view(-1), wp.float32),
            )


def _parts(count: int, most: int) -> Iterator[tuple[int, int]]:
    for first in range(0, count, most):
        yield first, min(first + most, count)


def is_class(labels: Tensor, value: int) -> Tensor:
    """True where labels of any type and shape have this value."""
    if not labels.dtype.is_floating_point and labels.dtype != torch.bool:
        limits = torch.iinfo(labels.dtype)
        if not limits.min <= value <= limits.max:
            # A comparison would wrap around.
            return torch.zeros(labels.shape, dtype=torch.bool, device=labels.device)
    if labels.device.type == "cpu" and labels.dtype != torch.bfloat16:
        # Without torch's threads, which take longer to meet than one to compare.
        return torch.from_numpy(labels.detach().numpy() == value)
    return labels == value


def _fill(mask: Tensor, spacing: Sequence[float], half: float, signed: bool, missing: float, out: Tensor) -> None:
    """Distances of masks (B,nx,ny,nz) into `out`; on a CPU one mask at a time."""
    count, nx, ny, nz = mask.shape
    shape = (count, nx, ny, nz)
    span = _span(mask[0]) if mask.device.type == "cpu" else None
    if span == (0, 0):
        out.fill_(missing)
        return
    with on_current_stream(mask, mask):
        kept = {
            name: torch.empty(length, dtype=torch.int32, device=mask.device)
            for name, length in transform.room_for(shape, signed).items()
        }
        kept["marks"].zero_()
        between = kept["between"].view(torch.float32)
        if span is not None and span != (0, nx):
            # Slices without foreground are left out of the first passes.
            between[: span[0] * ny * nz] = torch.inf
            between[span[1] * ny * nz :] = torch.inf
        room = {name: as_warp(tensor, wp.int32) for name, tensor in kept.items()}
        room["between"] = as_warp(between, wp.float32)
        source = as_warp(mask.view(torch.uint8).reshape(-1), wp.uint8)
        sizes = (float(spacing[0]), float(spacing[1]), float(spacing[2]))
        transform.transform(source, shape, sizes, half, signed, missing, room, as_warp(out.view(-1), wp.float32), span)


def _largest(volumes: Tensor) -> int:
    """Threads that one of the volumes (B,nx,ny,nz) takes at most."""
    _, nx, ny, nz = volumes.shape
    return nx * ny * max(nz, LANES)


def _span(mask: Tensor) -> tuple[int, int]:
    """The first slice along x with foreground, and the one after the last; (0, 0) where there is none."""
    found = np.flatnonzero(mask.numpy().any((1, 2)))
    return (int(found[0]), int(found[-1]) + 1) if len(found) else (0, 0)
