"""nnU-Net's trainer with the boundary loss."""

from __future__ import annotations

from typing import Any

from sdm.core.to_libraries import imported
from sdm.nnunet.with_boundary import WithBoundaryTerm

_trainer: Any = imported("nnunetv2.training.nnUNetTrainer.nnUNetTrainer", "nnunetv2").nnUNetTrainer


class nnUNetTrainerBoundary(_trainer):  # noqa: N801 (nnU-Net's trainers are called so)
    """nnU-Net's own training, with a boundary loss of exact distance maps in mm added, on the training's device.

    Its weight is 0.01 in the first epoch and grows by 0.01 an epoch up to `largest_weight`, after H. Kervadec et al.,
    "Boundary loss for highly unbalanced segmentation", MIDL 2019. Labels, regions, ignored labels, deep supervision, 2d
    and 3d configurations are taken as they are.
    """

    first_weight = 0.01
    largest_weight = 1.0
    # Distances are cut to this on both sides, mm; None for no cut.
    truncate: float | None = None

    def _build_loss(self) -> WithBoundaryTerm:
        manager: Any = self.label_manager
        foreground = None if manager.has_regions else [label for label in manager.foreground_labels if label != 0]
        return WithBoundaryTerm(
            super()._build_loss(),
            foreground,
            self.configuration_manager.spacing,
            truncate=self.truncate,
            ignore=manager.ignore_label,
            weight=self.first_weight,
        )

    def on_train_epoch_start(self) -> None:
        """Sets the epoch's weight."""
        super().on_train_epoch_start()
        self.loss.weight = min(self.first_weight * (self.current_epoch + 1), self.largest_weight)
