"""The boundary loss."""

from __future__ import annotations

from torch import Tensor

from sdm.errors import SDMError
from sdm.losses.pair import pair, require_tensors
from sdm.losses.targets import Spacing, signed_distance_target


def boundary_loss(
    probability: Tensor,
    target: Tensor,
    spacing: Spacing = 1.0,
    *,
    surface: str = "faces",
    distance: Tensor | None = None,
) -> Tensor:
    """mean(p * phi), with phi the target's signed distance map, negative inside.

    H. Kervadec et al., "Boundary loss for highly unbalanced segmentation", MIDL 2019. It may be negative and is least
    for p = 1 inside and 0 outside. It pulls too weakly alone: mix it with Dice by a schedule, as they and Ma do.
    A target that is empty or full has phi = 0, so the loss is 0 and has no gradient.

    Args:
        probability: (B,1,x,y,z) of the foreground, 0..1.
        target: (B,1,x,y,z), foreground not zero.
        spacing: Size of a voxel along each axis; phi is in its unit.
        surface: "faces", "centres", or "published" for phi as in the published code; see `signed_distance_target`.
        distance: phi, where it is known already; target and spacing are not looked at then.

    Returns:
        A scalar.

    Raises:
        SDMError: Shapes that do not fit together, or another surface.
    """
    if distance is None:
        require_tensors(probability, target)
        if probability.shape != target.shape:
            raise SDMError(f"a target of shape {tuple(target.shape)} does not fit {tuple(probability.shape)}")
        distance = signed_distance_target(target, spacing, surface=surface)
    probability, distance = pair(probability, distance)
    return (probability * distance).mean()
