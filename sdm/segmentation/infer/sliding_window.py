"""Prediction of volumes that are larger than a patch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from sdm.errors import SDMError
from sdm.runtime.torch_warp import to_device
from sdm.segmentation.data.position_channels import position_frame, positions

# Width of the weight of a window's voxels, as a share of the window.
WIDTH = 0.25


def sliding_window(
    field: Callable[[Tensor], Tensor],
    image: Tensor,
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    batch: int = 4,
    position: bool = False,
) -> Tensor:
    """The weighted mean of a network's output over overlapping windows.

    A window's voxel weighs as a Gaussian about its middle, since a network sees little beyond a window's border. The
    last window of an axis ends where the volume does. A volume smaller than the window is padded by its least value.

    Args:
        field: From (B,1,*window), with positions (B,4,*window), to (B,1,*window).
        image: (x,y,z), on the network's device.
        window: Voxels of a window along each axis.
        stride: Voxels between windows; half a window if not given. Ma's code: 18, 18, 4.
        batch: Windows at a time.
        position: Give `field` three more channels: where each voxel is in the image.

    Returns:
        (x,y,z) float32.

    Raises:
        SDMError: The stride is not between 1 and the window, so that voxels would be left out.
    """
    step = [max(1, n // 2) for n in window] if stride is None else list(stride)
    if len(step) != 3 or any(not 1 <= s <= n for s, n in zip(step, window, strict=True)):
        raise SDMError(f"a stride of {tuple(step)} leaves gaps between windows of {tuple(window)}")
    shape = image.shape
    room = [max(0, n - m) for n, m in zip(window, shape, strict=True)]
    pad = [x for r in reversed(room) for x in (r // 2, r - r // 2)]
    padded = functional.pad(image, pad, value=float(image.min())) if any(room) else image
    weight = _weight(window, image.device)
    total = torch.zeros(padded.shape, device=image.device, dtype=torch.float32)
    weights = torch.zeros_like(total)
    places = list(itertools.product(*(_starts(n, w, s) for n, w, s in zip(padded.shape, window, step, strict=True))))
    frames = to_device(_frames(places, window, shape, room), image.device) if position else None
    for first in range(0, len(places), batch):
        boxes = [tuple(slice(b, b + w) for b, w in zip(place, window, strict=True)) for place in places[first:][:batch]]
        windows = torch.stack([padded[box] for box in boxes])[:, None]
        if frames is not None:
            windows = torch.cat([windows, positions(frames[first:][:batch], window)], 1)
        values = field(windows)[:, 0].float()
        for box, value in zip(boxes, values, strict=True):
            total[box] += value * weight
            weights[box] += weight
    inner = tuple(slice(r // 2, r // 2 + n) for r, n in zip(room, shape, strict=True))
    return (total / weights)[inner]


def _frames(
    places: Sequence[Sequence[int]], window: Sequence[int], shape: Sequence[int], room: Sequence[int]
) -> Tensor:
    """(P,3,4): how positions run through each window."""
    matrix = torch.eye(3, dtype=torch.float64, device="cpu")
    middles = [(w - 1) / 2 - r // 2 for w, r in zip(window, room, strict=True)]
    middle = torch.tensor(middles, dtype=torch.float64, device="cpu")
    frames = [position_frame(matrix, middle.new_tensor(place) + middle, window, shape) for place in places]
    return torch.stack(frames).to(torch.float32)


def _starts(length: int, window: int, stride: int) -> list[int]:
    last = length - window
    return [*range(0, last, stride), last]


def _weight(window: Sequence[int], device: torch.device) -> Tensor:
    axes = []
    for size in window:
        offset = (torch.arange(size, device=device, dtype=torch.float32) - (size - 1) / 2) / (WIDTH * size)
        axes.append(torch.exp(-0.5 * offset.square()))
    return axes[0][:, None, None] * axes[1][None, :, None] * axes[2][None, None, :]
