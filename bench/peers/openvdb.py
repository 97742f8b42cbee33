"""OpenVDB's narrow-band level sets (`meshToLevelSet`), by a small program that is compiled where it is asked for.

Debian has it as libopenvdb-dev, with libtbb-dev and libboost-dev. Its Python module, where there is one, does the same
with what it takes to copy arrays.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import sdm
from sdm.bench.common.meshes import Case

SOURCE = Path(__file__).with_name("openvdb_level_set.cpp")
COMPILER = ("-O3", "-march=native", "-DNDEBUG", "-std=c++17")
LIBRARIES = ("-lopenvdb", "-ltbb")
NAME = "OpenVDB"


@dataclass(frozen=True)
class LevelSet:
    """A level set that OpenVDB made.

    Args:
        seconds: Of each call, from vertices and faces to the grid.
        cpu_seconds: Of each call, of all cores together.
        active_voxels: Those in the band.
        nbytes: Of the grid.
        peak_bytes: What the program had more in memory at its highest than before the calls.
        values: (N,) at the voxels that were asked for.
    """

    seconds: list[float]
    cpu_seconds: list[float]
    active_voxels: int
    nbytes: int
    peak_bytes: int
    values: np.ndarray


@cache
def missing() -> str | None:
    """Why it cannot run here, as a sentence; None if it can."""
    if not SOURCE.is_file():
        return f"{NAME} is left out: {SOURCE.name} is in a checkout alone"
    try:
        _program()
    except (OSError, subprocess.CalledProcessError) as error:
        lines = (getattr(error, "stderr", "") or str(error)).strip().splitlines()
        why = next((line for line in lines if "error" in line.lower()), lines[0])
        return f"{NAME} is left out, as {SOURCE.name} does not compile here: {why.strip()}"
    return None


def level_set(case: Case, grid: sdm.Grid, half_width: float, voxels: np.ndarray, calls: int) -> LevelSet:
    """Its level set of a mesh on the lattice of a grid with cubic voxels.

    Args:
        case: The mesh.
        grid: Where; not turned.
        half_width: Of the band, in voxels.
        voxels: (N,3) indices whose values are returned.
        calls: How many are timed, one after the other.
    """
    with tempfile.TemporaryDirectory() as folder:
        mesh, result = Path(folder) / "mesh", Path(folder) / "result"
        with mesh.open("wb") as file:
            for array, dtype in (
                ([len(case.vertices), len(case.faces)], "<i4"),
                ([grid.spacing[0], *grid.origin, half_width], "<f8"),
                ([len(voxels)], "<i4"),
                (case.vertices, "<f4"),
                (case.faces, "<i4"),
                (voxels, "<i4"),
            ):
                file.write(np.ascontiguousarray(array, dtype).tobytes())
        subprocess.run([str(_program()), str(mesh), str(result), str(calls)], check=True)
        data = result.read_bytes()
    numbers = np.frombuffer(data[: 8 * (2 * calls + 3)], "<f8")
    return LevelSet(
        numbers[0 : 2 * calls : 2].tolist(),
        numbers[1 : 2 * calls : 2].tolist(),
        *(int(number) for number in numbers[-3:]),
        np.frombuffer(data[8 * (2 * calls + 3) :], "<f4"),
    )


@cache
def _program() -> Path:
    """The program, compiled into a folder that goes when this process ends."""
    compiler = os.environ.get("CXX") or shutil.which("g++") or "c++"
    folder = tempfile.TemporaryDirectory(prefix="sdm-openvdb-")
    _kept.append(folder)
    program = Path(folder.name) / "openvdb_level_set"
    words = [compiler, *COMPILER, str(SOURCE), "-o", str(program), *LIBRARIES]
    subprocess.run(words, check=True, capture_output=True, text=True)
    return program


_kept: list[tempfile.TemporaryDirectory[str]] = []
