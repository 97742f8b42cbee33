"""Number of threads for the work beside a device."""

from __future__ import annotations

import torch

from sdm.kernels.launch import cores

# More share one disk, and one interpreter, without gain.
MOST = 16


def threads_beside(device: torch.device) -> int:
    """Threads of a stage beside a device: the cores of a GPU's host, half of them beside an engine on the host."""
    return max(1, min(MOST, cores() if device.type == "cuda" else cores() // 2))
