"""bfloat16 where a device has it, and the layout in memory that its convolutions like."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch


def has_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies in bfloat16: every GPU that Warp runs on as one, and CPUs with instructions for it.

    A CPU without them takes bfloat16 too, but more time for it than for float32.
    """
    if device.type == "cuda":
        return True
    # Not public, and not in every version: without it float32 is right, only slower.
    asked = (getattr(torch.cpu, name, None) for name in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"))
    return device.type == "cpu" and any(ask() for ask in asked if ask is not None)


def reduced(device: torch.device) -> AbstractContextManager[None]:
    """Convolutions in bfloat16 where the device has it; weights, sums and losses stay float32."""
    return torch.autocast(device.type, torch.bfloat16, enabled=has_bfloat16(device))


def layout(device: torch.device) -> torch.memory_format:
    """How networks and images (B,C,x,y,z) lie in memory: channels side by side where bfloat16 likes that."""
    return torch.channels_last_3d if has_bfloat16(device) else torch.contiguous_format
