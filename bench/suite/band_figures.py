"""Figures of narrow bands and of surfaces that the public pages have, from the records."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import geometric_mean
from typing import Any

RESOLUTIONS = (512, 1024, 2048, 4096)


def spread(numbers: Sequence[float]) -> list[float]:
    """The least and the most."""
    return [min(numbers), max(numbers)]


def shares_of_openvdb(record: Any) -> list[float]:
    """Least and most of our processor time as a share of OpenVDB's."""
    ours = {(r["mesh"], r["resolution"]): r["cpu"] for r in record["rows"] if r["library"] == "sdm"}
    theirs = {(r["mesh"], r["resolution"]): r["cpu"] for r in record["rows"] if r["library"] == "OpenVDB"}
    return spread([ours[key] / theirs[key] for key in theirs if key in ours])


def _milliseconds(record: Any) -> list[list[float]]:
    rows = record["rows"]
    return [[1e3 * r["seconds"] for r in rows if r["resolution"] == n] for n in RESOLUTIONS]


def milliseconds_on_a_gpu(record: Any) -> list[float]:
    """Least and most milliseconds of a band, for each resolution of the page."""
    return [ms for found in _milliseconds(record) for ms in spread(found)]


def means_on_a_gpu(record: Any) -> list[float]:
    """Geometric means of the milliseconds over the meshes, for each resolution of the page."""
    return [geometric_mean(found) for found in _milliseconds(record)]


def beside_others(record: Any) -> list[float]:
    """Ratios of Newton's and PhysicsNeMo's times of a band to ours."""
    seconds = {(r["library"], r["mesh"], r["resolution"]): r["seconds"] for r in record["rows"]}
    return [
        geometric_mean([s / seconds["sdm", mesh, n] for (name, mesh, n), s in seconds.items() if name == library])
        for library in ("Newton", "PhysicsNeMo")
    ]


def beside_meshlib(record: Any) -> list[float]:
    """Least and most ratios of MeshLib's times of a band to ours, its build counted, then its searches alone.

    Of meshes at which its signs pass: the time of a wrong answer is compared with nothing.
    """
    ours = {(r["mesh"], r["resolution"]): r["seconds"] for r in record["rows"] if r["library"] == "sdm"}
    fine = [r for r in record["rows"] if r["library"] == "MeshLib, CUDA" and r["signs"] == 0]
    found = [[r[name] / ours[r["mesh"], r["resolution"]] for r in fine] for name in ("seconds", "query")]
    return [ratio for ratios in found for ratio in spread(ratios)]


def watertight_seconds(record: Any) -> list[float]:
    """Seconds of `sdm watertight` of the first mesh: repeated, a file of a folder, the first call of a process."""
    return [record["rows"][0][name] for name in ("warm", "folder", "first")]


def surface_milliseconds(record: Any) -> list[float]:
    """Least and most milliseconds of surfaces at 1024^3: cubes of maps and of bands, dual ones with their mesh."""
    methods = "sdm cubes", "sdm band", "sdm dual by the mesh"
    rows = [row for row in record["rows"] if row["resolution"] == 1024]
    found = [[1e3 * row["seconds"] for row in rows if row["method"] == method] for method in methods]
    return [ms for times in found for ms in spread(times)]


def voxels_off_edges(record: Any) -> list[float]:
    """Largest distances of points of sharp edges from dual surfaces made with the mesh: of fandisk, of all meshes."""
    rows = [row for row in record["rows"] if row["method"] == "sdm dual by the mesh"]
    fandisk = [row["edges_most"] for row in rows if row["mesh"] == "fandisk"]
    return [max(fandisk), max(row["edges_most"] for row in rows)]
