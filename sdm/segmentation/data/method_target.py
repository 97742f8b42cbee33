"""The distance map of a label that a method is trained on."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from sdm.losses import clipped_sdf, foreground_distance, normalized_signed_distance, signed_distance_target
from sdm.segmentation.train.methods import Map

# Where Juhl clips, in voxels of the largest spacing.
CLIP_VOXELS = 5.0


def distance_map(
    label: Tensor, kind: Map, spacing: Sequence[float] = (1.0, 1.0, 1.0), *, published: bool = False
) -> Tensor:
    """One of four maps of labels (B,1,x,y,z); float32, negative inside, 0 where a label is empty or full.

    - foreground: depth inside the foreground over its greatest, 0..1.
    - normalized: signed, its inside over the depth and its outside over the reach, -1..1.
    - signed: in the spacing's unit.
    - clipped: signed, clipped at 5 voxels (of the largest spacing) and divided by that, -1..1.

    Args:
        label: Foreground not zero. Give whole cases: the map of a patch does not know the organ beyond it, and its
            scale would be another for each patch.
        kind: One of the above.
        spacing: Size of a voxel along each axis.
        published: As in Ma's public code where it differs: voxels of size 1, and 0 on the foreground's outer voxels.
    """
    if published:
        spacing = (1.0, 1.0, 1.0)
    surface = "published" if published else "faces"
    if kind == "foreground":
        return foreground_distance(label, spacing, normalized=True)
    if kind == "normalized":
        return normalized_signed_distance(label, spacing, surface=surface)
    signed = signed_distance_target(label, spacing, surface=surface)
    return clipped_sdf(signed, CLIP_VOXELS * max(spacing)) if kind == "clipped" else signed


def map_of_distances(distances: Tensor, kind: Map) -> Tensor:
    """A map as above of signed distances (B,x,y,z), negative inside; "clipped" as "signed": a patch clips it."""
    inside, outside = (-distances).clamp(min=0), distances.clamp(min=0)
    inner, outer = (side.flatten(1).amax(1).clamp(min=1e-12).view(-1, 1, 1, 1) for side in (inside, outside))
    if kind == "foreground":
        return inside / inner
    return outside / outer - inside / inner if kind == "normalized" else distances
