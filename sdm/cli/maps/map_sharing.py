"""Processes that share the meshes of `sdm compute`: how many, and started before torch is imported."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from sdm.runtime.sharing.process_count import gpus_expected, processes_for
from sdm.runtime.sharing.processes import OtherProcesses

# Module of the job that processes do.
JOB = "sdm.cli.maps.map_job"
DEFAULT_RESOLUTION = 128
# A map of more bytes, or one alone, is computed and written in the caller's thread, which an interrupt ends at once.
LARGEST_BESIDE = 1 << 28
# About what one process of an H100's host takes for a mesh and its map on a disk: 100 to 150 a second of 128^3.
SECONDS_OF_A_MESH, BYTES_A_SECOND = 3e-3, 2e9
# Endings of most meshes, and files that are looked at to tell whether there are many.
USUAL, LOOKED_AT = (".ply", ".stl", ".obj", ".off", ".glb", ".gltf", ".vtk", ".vtp"), 100_000


def processes_sharing(meshes: int, voxels: int, devices: list[str]) -> list[str]:
    """The device of each process that makes maps of so many voxels: see `processes_for`."""
    seconds = meshes * (SECONDS_OF_A_MESH + 4 * voxels / BYTES_A_SECOND)
    return processes_for(devices, seconds, several=4 * voxels <= LARGEST_BESIDE)


@contextmanager
def early_processes(
    meshes: Sequence[Path], device: str, resolution: Sequence[int] | None, done: Path | None = None
) -> Iterator[OtherProcesses | None]:
    """Processes that will probably share the meshes, which import what they need while this one does; None of few.

    Who has looked at the meshes and at the GPUs starts more, or takes fewer. They end with the block.

    Args:
        meshes: Files and folders, as they were given.
        device: As commands take it.
        resolution: Voxels along each axis, or along all, if that is known.
        done: A folder with a file for about each mesh that is done.
    """
    gpus = gpus_expected(device)
    sides = resolution if resolution is not None and len(resolution) in (1, 3) else [DEFAULT_RESOLUTION]
    voxels = math.prod(sides) ** (3 // len(sides))
    # Looked for only where there is a GPU.
    left = _about(meshes) - (_about([done], "") if done is not None else 0) if gpus and voxels > 0 else 0
    processes = processes_sharing(left, voxels, gpus) if left > 1 else []
    if len(processes) < 2:
        yield None
        return
    with OtherProcesses(JOB) as others:
        others.start(processes[1:])
        yield others


def _about(meshes: Sequence[Path], *endings: str) -> int:
    """About how many files there are with these endings, by default those of meshes; fewer where there are very many.

    A path that is no folder counts as one.
    """
    folders = [path for path in meshes if path.is_dir()]
    names = (name for folder in folders for _, _, files in os.walk(folder) for name in files)
    return (
        len(meshes) - len(folders) + sum(name.lower().endswith(endings or USUAL) for name in islice(names, LOOKED_AT))
    )
