"""Distance maps for batchgeneratorsv2 and nnU-Net v2: `SignedDistanceTarget`, and trainers with the boundary loss.

nnU-Net finds the trainers by the environment variable `nnUNet_extTrainer`, which names the folder `trainers` here:

    export nnUNet_extTrainer="$(python -c 'import sdm.nnunet as n; print(n.TRAINERS)')"
    nnUNetv2_train DATASET 3d_fullres 0 -tr nnUNetTrainerBoundary
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.nnunet.distance_target import SignedDistanceTarget
    from sdm.nnunet.trainers.boundary_trainer import nnUNetTrainerBoundary
    from sdm.nnunet.with_boundary import WithBoundaryTerm

# Each needs a library that the others do not.
_HOMES = {
    "SignedDistanceTarget": "distance_target",
    "WithBoundaryTerm": "with_boundary",
    "nnUNetTrainerBoundary": "trainers.boundary_trainer",
}

TRAINERS = str(Path(__file__).parent / "trainers")

__all__ = ["TRAINERS", "SignedDistanceTarget", "WithBoundaryTerm", "nnUNetTrainerBoundary"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'sdm.nnunet' has no attribute {name!r}")
    return getattr(import_module(f"sdm.nnunet.{_HOMES[name]}"), name)
