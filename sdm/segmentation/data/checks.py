"""Checks of cases: what would spoil a training is refused before it begins."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from sdm.core.grid import Grid
from sdm.errors import GridError, SDMError
from sdm.segmentation.data.case import Case

# How far the voxel sizes of two cases may be apart: more is another scanner protocol, or a mistake.
TOLERANCE = 0.05
MOST_NAMED = 5


def check_cases(cases: Sequence[Case], *, spacing: tuple[float, float, float] | None = None) -> None:
    """Look at every case.

    Args:
        cases: Images with labels.
        spacing: The voxel size that all must have, in mm; that of most cases if not given.

    Raises:
        SDMError: Some cannot be used; each is named with its reason.
    """
    # Alike by their first digits, not by their last decimals: voxels may be of micrometres.
    sizes = [tuple(f"{s:.3g}" for s in case.spacing) for case in cases]
    most = cases[sizes.index(max(sizes, key=sizes.count))].spacing if cases else (1.0, 1.0, 1.0)
    wanted = most if spacing is None else spacing
    bad = [f"{case.name} {why}" for case in cases if (why := _reason(case, wanted)) is not None]
    if bad:
        more = f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else ""
        raise SDMError(
            f"{len(bad)} of {len(cases)} cases cannot be used: {'; '.join(bad[:MOST_NAMED])}{more}; "
            "mend them or take them out"
        )


def _reason(case: Case, spacing: Sequence[float]) -> str | None:
    label = case.label
    if (why := _wrong_image(case)) is not None:
        return why
    if label is None:
        return "has no label"
    if label.shape != case.image.shape:
        return f"has an image of shape {tuple(case.image.shape)} and a label of shape {tuple(label.shape)}"
    if not label.any():
        return "has no foreground"
    if label.all():
        return "has no background"
    return _wrong_spacing(case, spacing)


def _wrong_image(case: Case) -> str | None:
    if case.image.ndim != 3:
        return f"has an image of shape {tuple(case.image.shape)}, not (x,y,z)"
    if not torch.isfinite(case.image).all():
        return "has values that are not finite"
    return None


def check_image(case: Case, spacing: Sequence[float]) -> None:
    """Refuse an image that a network cannot segment which was trained on voxels of a size in mm.

    Raises:
        SDMError: The image is not (x,y,z), has values that are not finite, of which networks say nothing, or voxels of
            another size.
        GridError: Its axes are not orthogonal.
    """
    if (why := _wrong_image(case)) is not None:
        raise SDMError(f"{case.source} {why}: mend it")
    if (why := _wrong_spacing(case, spacing)) is not None:
        raise SDMError(f"{case.source} {why}: resample it")
    try:
        Grid.from_affine(case.affine, case.image.shape)
    except GridError as error:
        raise GridError(f"{case.source} cannot be segmented: {error}") from None


def _wrong_spacing(case: Case, spacing: Sequence[float]) -> str | None:
    if same_spacing(case.spacing, spacing):
        return None
    return f"has voxels of {voxel(case.spacing)} mm where {voxel(spacing)} mm are expected"


def same_spacing(one: Sequence[float], other: Sequence[float]) -> bool:
    """True if two voxel sizes are alike, as far as scanners and files are exact."""
    return all(abs(a - b) <= TOLERANCE * b for a, b in zip(one, other, strict=True))


def voxel(size: Sequence[float]) -> str:
    """A voxel's size in words."""
    return " x ".join(f"{s:.4g}" for s in size)
