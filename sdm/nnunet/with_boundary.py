"""A loss of nnU-Net's and the boundary loss, with distance maps made from the target where it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.losses.boundary import boundary_loss


class WithBoundaryTerm(nn.Module):
    """`loss(output, target) + weight * boundary`, the boundary loss of the finest output's classes.

    The maps are made on the target's device in each step, by one transform for all classes of a sample, so that they
    are those of the augmented target and no worker computes them. Classes that a patch lacks, or is full of, add
    nothing.

    Args:
        loss: The loss to add to; of lists of outputs and targets, finest first, with deep supervision.
        classes: Values of the foreground, in the order of the output's channels behind the background's; None where
            the target has a mask for each of the output's channels (regions).
        spacing: Size of a voxel along each axis of the arrays, two or three, in the unit of the maps.
        truncate: Cut distances to this on both sides.
        ignore: Value of voxels that have no label; of masks, the last channel says where they are.
        weight: Of the boundary loss.
    """

    def __init__(
        self,
        loss: nn.Module,
        classes: Sequence[int] | None,
        spacing: Sequence[float],
        *,
        truncate: float | None = None,
        ignore: int | None = None,
        weight: float = 0.01,
    ) -> None:
        super().__init__()
        self.loss, self.classes, self.truncate = loss, None if classes is None else list(classes), truncate
        self.spacing = [float(s) for s in spacing]
        self.ignore, self.weight = ignore, float(weight)

    def forward(self, output: Any, target: Any) -> Tensor:
        """The sum, a scalar."""
        finest, labels = (x[0] if isinstance(x, list | tuple) else x for x in (output, target))
        return self.loss(output, target) + self.weight * self.boundary(finest, labels)

    def boundary(self, output: Tensor, target: Tensor) -> Tensor:
        """The boundary loss of logits (B,C,...) and the target (B,1,...), or masks (B,C,...)."""
        logits, known = output.float(), None
        if self.classes is None:
            probability, masks = torch.sigmoid(logits), target[:, : logits.shape[1]]
            if self.ignore is not None:
                known = target[:, -1:] == 0
        else:
            probability, masks = torch.softmax(logits, 1)[:, 1:], target
            if self.ignore is not None:
                known = target != self.ignore
        distance = self._maps(masks)
        if known is not None:
            distance = distance * known
        # All classes as one of a batch.
        return boundary_loss(_volumes(probability), _volumes(probability), distance=_volumes(distance))

    @torch.no_grad()
    def _maps(self, masks: Tensor) -> Tensor:
        batch, channels, *shape = masks.shape
        is_flat = len(shape) == 2
        sizes = [max(self.spacing), *self.spacing] if is_flat else self.spacing
        volumes = masks.reshape(batch * channels, *([1] if is_flat else []), *shape)
        given: Any = {"signed": True, "surface": "faces", "missing": 0.0}
        if self.classes is None:
            maps = euclidean_distance_transform(volumes, sizes, **given)
        else:
            maps = euclidean_distance_transform(volumes, sizes, classes=self.classes, **given)
        if self.truncate is not None:
            maps = maps.clamp(-self.truncate, self.truncate)
        return maps.reshape(batch, -1, *shape)


def _volumes(values: Tensor) -> Tensor:
    batch, channels, *shape = values.shape
    return values.reshape(batch * channels, 1, *([1] if len(shape) == 2 else []), *shape)
