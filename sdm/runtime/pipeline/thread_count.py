"""Number of threads for the work beside a device."""

from __future__ import annotations

import torch

from sdm.kernels.launch import cores

# More share one disk, and one interpreter, without gain.
MOST = 16


def threads_beside(device: torch.device, of: int | None = None) -> int:
    """Threads of a stage beside a device: the cores of a GPU's host, half of them beside an engine on the host.

    `of` so many cores, by default this machine's.
    """
    of = cores() if of is None else of
    return max(1, min(MOST, of if device.type == "cuda" else of // 2))


# Meshes are read by short steps that hold Python's lock, for which more threads only wait.
MOST_READERS = 4
# Maps are written by few long steps without it.
MOST_WRITERS = 8


def readers_beside(device: torch.device, of: int | None = None) -> int:
    """Threads that read meshes of this machine beside a device, see `threads_beside`."""
    return min(MOST_READERS, threads_beside(device, of))


def writers_beside(device: torch.device, of: int | None = None) -> int:
    """Threads that write maps beside a device, see `threads_beside`."""
    return min(MOST_WRITERS, threads_beside(device, of))
