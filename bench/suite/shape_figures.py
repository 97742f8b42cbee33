"""Figures of the pages of shapes and surrogates, for `sdm.bench.suite.page_figures`: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

SHAPES, SURROGATE = "sdm/shapes/README.md", "sdm/surrogate/README.md"
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
        SURROGATE,
        "among {:,} shapes, is {:.3f}",
        "surrogate-worst",
        lambda r: [r["shapes"], r["worst"][0]["dice"]],
    ),
    (
        SURROGATE,
        "the worst Dice by search is {:.3f}",
        "surrogate-worst-ends",
        lambda r: [r["worst"][0]["dice"]],
    ),
    (
        SURROGATE,
        "mean error {:.2f} mm at voxels of {:.1f} mm, {:.2f} mm near the surface, mean Dice {:.3f}",
        "surrogate-atria-cuda",
        lambda r: [r["mean"], r["voxel"], r["near"], r["dice"]],
    ),
)
