"""Number of threads for the work beside a device."""

from __future__ import annotations

import os

import torch

# More share one disk, and one interpreter, without gain.
MOST = 16


def threads_beside(device: torch.device) -> int:
    """Threads of a stage beside a device: the cores of a GPU's host, half of them beside an engine on the host."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(MOST, cores if device.type == "cuda" else cores // 2))
