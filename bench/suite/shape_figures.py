"""Figures of the pages of shapes and surrogates, for `sdm.bench.suite.page_figures`: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

SHAPES, SURROGATE = "sdm/shapes/README.md", "sdm/surrogate/README.md"


# Of the table of networks, in its order.
COLUMNS = ("mae_mm", "mae_near_mm", "surface_mean_mm", "surface_95_mm", "dice_mean", "dice_worst")


def times_libigl(record: Any) -> list[float]:
    """On the reference mesh, and with triangles on those of equal error near the surface and everywhere."""
    found = record["times_libigl_by_torch"]
    near, everywhere = found["mae_near_mm"], found["mae_mm"]
    return [found["reference"]["times"], near["times"], near["triangles"], everywhere["times"], everywhere["triangles"]]


def milliseconds(record: Any) -> list[float]:
    """Of the network by torch, the exact engine and the quicker libigl, both on the reference mesh."""
    ms = {(row["method"], row["of"]): row["ms"] for row in record["rows"]}
    mesh = "20,000 triangles"
    libigl = min(ms["libigl winding number", mesh], ms["libigl pseudonormal", mesh])
    return [ms["SDMNN+", "torch"], libigl, ms["exact engine", mesh]]


def errors(record: Any) -> list[float]:
    """Near the surface and everywhere, of the network and of libigl on the two meshes of equal error."""
    rows = {(row["method"], row["of"]): row for row in record["rows"]}
    equal = record["times_libigl_by_torch"]
    found = []
    for name in ("mae_near_mm", "mae_mm"):
        mesh = f"{equal[name]['triangles']:,} triangles"
        found += [rows["SDMNN+", "torch"][name], rows["libigl pseudonormal", mesh][name]]
    return found


SHAPE_FIGURES: tuple[tuple[str, str, str, Callable[[Any], Sequence[Any]]], ...] = (
    (
        SHAPES,
        "within {:.3f} mm on average and {:.2f} mm at most",
        "cochlea_fit",
        lambda r: [r["fit"]["mean_symmetric_surface_distance_mm"], r["fit"]["hausdorff_mm"]],
    ),
    (
        SHAPES,
        "is {:.3f} mm from an atrium on average, and {:.2f} from",
        "shape-model-atria",
        lambda r: [r["mean_mm"], r["worst_mm"]],
    ),
    (
        SHAPES,
        "by {} modes of points {:.2f} mm from its surface, by as many of maps {:.2f}",
        "shape-model-atria",
        lambda r: [r["modes"][-1], *(r["curves"][key]["generalisation"][-1] for key in ("points", "maps"))],
    ),
    (
        SHAPES,
        "random shapes of these {:.2f} and {:.2f} mm from the nearest atrium",
        "shape-model-atria",
        lambda r: [r["curves"][key]["specificity"][-1] for key in ("points", "maps")],
    ),
    (
        SURROGATE,
        "among {:,} shapes, is {:.3f}",
        "surrogate-worst",
        lambda r: [r["shapes"], r["worst"][0]["dice"]],
    ),
    (
        SURROGATE,
        "| SDMNN+ (shipped) | {:.4f} | {:.4f} | {:.4f} | {:.3f} | {:.3f} | {:.3f} |",
        "surrogate-pointwise-cpu",
        lambda r: [r["accuracy"]["models"]["sdmnn-plus-ends"][key] for key in COLUMNS],
    ),
    (
        SURROGATE,
        "| SDMNN+ shipped before | {:.4f} | {:.4f} | {:.4f} | {:.3f} | {:.3f} | {:.3f} |",
        "surrogate-no-corners-cuda",
        lambda r: [r["accuracy"]["models"]["sdmnn-plus-ends"][key] for key in COLUMNS],
    ),
    (
        SURROGATE,
        "takes {:.1f} ms, libigl on the mesh of 20,000 triangles {:,.0f} ms, our exact engine {:.0f} ms",
        "surrogate-error-time",
        milliseconds,
    ),
    (
        SURROGATE,
        "**{:.0f} times** as quick as libigl on 20,000 triangles",
        "surrogate-error-time",
        lambda r: times_libigl(r)[:1],
    ),
    (
        SURROGATE,
        "**{:.0f} times** on {:,} triangles by the error near the surface, and **{:.0f} times** on {:,} by that of all",
        "surrogate-error-time",
        lambda r: times_libigl(r)[1:],
    ),
    (
        "docs/guide.md",
        "{:.0f} times as fast by torch as libigl on the reference mesh of 20,000 triangles",
        "surrogate-error-time",
        lambda r: times_libigl(r)[:1],
    ),
    (
        "docs/guide.md",
        "{:.0f} times by the error near the surface, {:.0f} times by that of all voxels",
        "surrogate-error-time",
        lambda r: times_libigl(r)[1::2],
    ),
    (
        "docs/guide.md",
        "without AMX {:.0f} times, [record]",
        "surrogate-error-time-no-amx",
        lambda r: times_libigl(r)[:1],
    ),
    (
        SURROGATE,
        "near the surface {:.4f} mm by the network and {:.4f} by the mesh, everywhere {:.4f} and {:.4f}",
        "surrogate-error-time",
        errors,
    ),
    (
        SURROGATE,
        "{:.1f} ms and {:.0f} times, at equal error {:.0f} on {:,} triangles and {:.0f} on {:,}",
        "surrogate-error-time-no-amx",
        lambda r: [r["rows"][0]["ms"], *times_libigl(r)],
    ),
    (
        SURROGATE,
        "without AMX {:.0f} times, and at equal error {:.0f} on {:,} triangles and {:.0f} on {:,}",
        "surrogate-error-time-epyc",
        times_libigl,
    ),
    (
        SURROGATE,
        "mean error {:.2f} mm at voxels of {:.1f} mm, {:.2f} mm near the surface, mean Dice {:.3f}",
        "surrogate-atria-cuda",
        lambda r: [r["mean"], r["voxel"], r["near"], r["dice"]],
    ),
)
