"""Figures of the pages of shapes and surrogates, for `sdm.bench.suite.page_figures`: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

SHAPES, SURROGATE = "sdm/shapes/README.md", "sdm/surrogate/README.md"


# Of the table of networks, in its order.
COLUMNS = ("mae_mm", "mae_near_mm", "surface_mean_mm", "surface_95_mm", "dice_mean", "dice_worst")


def _times_libigl(found: Any) -> list[float]:
    """On the reference mesh, and with triangles on those of equal error near the surface and everywhere."""
    near, everywhere = found["mae_near_mm"], found["mae_mm"]
    return [found["reference"]["times"], near["times"], near["triangles"], everywhere["times"], everywhere["triangles"]]


def _beside_libigl(ms: dict[tuple[str, str], float]) -> list[float]:
    """Milliseconds of the network by torch, by how much the quicker libigl takes longer on three meshes, and others."""
    own = ms["SDMNN+", "torch"]
    meshes = [f"{count} triangles" for count in ("20,000", "7,000", "4,000")]
    large, middle, small = (min(ms["libigl winding number", t], ms["libigl pseudonormal", t]) for t in meshes)
    others = [ms["SDMNN+", "openvino"], ms["SDMNN+", "onnxruntime"], ms["exact engine", meshes[0]]]
    return [own, large / own, large, middle / own, small / own, *others]


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
        "surrogate-no-corners-cuda",
        lambda r: [r["accuracy"]["models"]["sdmnn-plus-ends"][key] for key in COLUMNS],
    ),
    (
        SURROGATE,
        "| SDMNN+ shipped before, with corners | {:.4f} | {:.4f} | {:.4f} | {:.3f} | {:.3f} | {:.3f} |",
        "surrogate-ends-cuda",
        lambda r: [r["accuracy"]["models"]["sdmnn-plus"][key] for key in COLUMNS],
    ),
    (
        SURROGATE,
        (
            "{:.1f} ms, {:.0f} times as quick as libigl on the mesh of 20,000 triangles ({:.0f} ms) and {:.0f} times "
            "as on one of 7,000, {:.0f} times as on one of 4,000, all of which are nearer to the surface than the "
            "network is; OpenVINO has {:.1f} ms, ONNX Runtime {:.1f} ms, our exact engine {:.0f} ms"
        ),
        "surrogate-error-time",
        lambda r: _beside_libigl({(row["method"], row["of"]): row["ms"] for row in r["rows"]}),
    ),
    (
        SURROGATE,
        (
            "{:.0f} times on the reference mesh, {:.0f} times on {:,} triangles, and {:.0f} times on {:,}, which are "
            "no worse in the mean"
        ),
        "surrogate-error-time-epyc",
        lambda r: _times_libigl(r["times_libigl_by_torch"]),
    ),
    (
        SURROGATE,
        "mean error {:.2f} mm at voxels of {:.1f} mm, {:.2f} mm near the surface, mean Dice {:.3f}",
        "surrogate-atria-cuda",
        lambda r: [r["mean"], r["voxel"], r["near"], r["dice"]],
    ),
)
