"""The devices of this machine that make a dataset."""

from __future__ import annotations

import torch

from sdm.core.device import choose_device


def devices_for(wanted: str | torch.device | None) -> list[str]:
    """Every GPU of this machine that is of the first one's kind, else the CPU; or the one device that was requested.

    GPUs of two kinds may differ in the last bits, and a dataset must not depend on who made which shard.

    Raises:
        DeviceError: It is not there.
    """
    if wanted is None or wanted == "auto":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        return [f"cuda:{n}" for n in range(count) if device_kind(f"cuda:{n}") == device_kind("cuda:0")] or ["cpu"]
    return [str(choose_device(wanted))]


def device_kind(device: str | torch.device) -> str:
    """Kind of a device, the same for all that compute the same bits: the GPU's name, or "cpu"."""
    where = torch.device(device)
    return torch.cuda.get_device_name(where) if where.type == "cuda" else "cpu"
