"""Figures of the pages about other tools, for `sdm.bench.suite.page_figures`: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import exp, log
from typing import Any

PAGE, SIGNS = "docs/other-tools.md", "docs/explain/signs.md"
LIBIGL, MESH_TO_SDF, SCIPY = "docs/from/libigl.md", "docs/from/mesh_to_sdf.md", "docs/from/scipy.md"

Numbers = Callable[[Any], Sequence[Any]]

TRIMESH, OPEN3D = "trimesh.proximity.signed_distance", "open3d RaycastingScene"
PSEUDONORMAL, FAST = "igl.signed_distance, pseudonormal", "igl.signed_distance, fast winding number"
SAMPLES = "mesh_to_sdf, by a million samples"


def _cases(record: Any, library: str) -> list[dict[str, Any]]:
    return [case for case in record["cases"] if case["library"] == library]


def _times(record: Any, library: str) -> list[float]:
    """Their processor time over ours: geometric mean, least and greatest."""
    found = [case["theirs"]["cpu_s"] / case["ours"]["cpu_s"] for case in _cases(record, library)]
    return [exp(sum(map(log, found)) / len(found)), min(found), max(found)]


def _wrong(record: Any, library: str) -> int:
    return sum(case["theirs"]["wrong_signs"] for case in _cases(record, library))


def _row(library: str) -> Numbers:
    """Of a row of the table: times, and wrong signs of theirs and of ours."""

    def numbers(record: Any) -> list[float]:
        ours = sum(case["ours"]["wrong_signs"] for case in _cases(record, library))
        return [*_times(record, library), _wrong(record, library), ours]

    return numbers


def _wrong_by_normals_and_rays(record: Any) -> list[int]:
    found = [_wrong(record, library) for library in (TRIMESH, OPEN3D, PSEUDONORMAL)]
    return [min(found), max(found), sum(case["theirs"]["sure"] for case in _cases(record, TRIMESH))]


def _where_libigl_is_quicker(record: Any) -> list[int]:
    """Most triangles of meshes on which libigl is quicker by pseudonormals, and fewest of those on which it is not."""
    found = [
        (case["triangles"], case["theirs"]["cpu_s"] < case["ours"]["cpu_s"]) for case in _cases(record, PSEUDONORMAL)
    ]
    return [max(count for count, quicker in found if quicker), min(count for count, quicker in found if not quicker)]


def _classes(count: int, *tools: str) -> Numbers:
    """Seconds of so many classes by each tool."""

    def numbers(record: Any) -> list[float]:
        case = next(case for case in record["cases"] if case["classes"] == count)
        return [case["cpu_ms"][tool] / 1000 for tool in tools]

    return numbers


def _pipeline(library: str) -> Numbers:
    def numbers(record: Any) -> list[float]:
        case = next(case for case in record["cases"] if case["library"] == library)
        return [case[way]["cpu_s_per_sample"] for way in ("nothing", "sdm", "SciPy")]

    return numbers


OTHER_TOOLS_FIGURES: tuple[tuple[str, str, str, Numbers], ...] = (
    (PAGE, "| trimesh, with Embree | {:.0f} ({:.1f} to {:.0f}) | {}; {} |", "dropins-cpu", _row(TRIMESH)),
    (PAGE, "| Open3D | {:.1f} ({:.2f} to {:.1f}) | {}; {} |", "dropins-cpu", _row(OPEN3D)),
    (PAGE, "| libigl, pseudonormals | {:.1f} ({:.2f} to {:.1f}) | {}; {} |", "dropins-cpu", _row(PSEUDONORMAL)),
    (PAGE, "| libigl, fast winding numbers | {:.1f} ({:.2f} to {:.1f}) | {}; {} |", "dropins-cpu", _row(FAST)),
    (PAGE, "| mesh_to_sdf, a million samples | {:.0f} ({:.0f} to {:.0f}) | {}; {} |", "dropins-cpu", _row(SAMPLES)),
    (SIGNS, "had {} to {} wrong signs of {:,}", "dropins-cpu", _wrong_by_normals_and_rays),
    (MESH_TO_SDF, "took {:.0f} to {:.0f} times our processor time", "dropins-cpu", lambda r: _times(r, SAMPLES)[1:]),
    (
        LIBIGL,
        "of {:,} triangles or fewer, and with `sdm` on those of {:,} or more",
        "dropins-cpu",
        _where_libigl_is_quicker,
    ),
    (
        PAGE,
        "| 16 classes of 128^3 | {:.2f} | {:.1f} | {:.1f} |",
        "edt-multiclass-cpu",
        _classes(16, "sdm", "edt", "SciPy"),
    ),
    (
        PAGE,
        "| 64 classes of 96^3 | {:.2f} | {:.1f} | {:.1f} |",
        "edt-multiclass-cpu",
        _classes(64, "sdm", "edt", "SciPy"),
    ),
    (SCIPY, "took {:.2f} s of processor time, SciPy {:.1f}", "edt-multiclass-cpu", _classes(16, "sdm", "SciPy")),
    (PAGE, "| MONAI | {:.2f} | {:.2f} | {:.2f} |", "pipelines-cpu", _pipeline("MONAI")),
    (PAGE, "| TorchIO | {:.2f} | {:.2f} | {:.2f} |", "pipelines-cpu", _pipeline("TorchIO")),
    (PAGE, "| batchgeneratorsv2 | {:.2f} | {:.2f} | {:.2f} |", "pipelines-cpu", _pipeline("batchgeneratorsv2")),
)
