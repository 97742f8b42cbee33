"""Files of trained segmentation networks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.errors import FormatError
from sdm.io.files.torch_file import load_torch, save_torch
from sdm.io.files.typed_record import check_record
from sdm.segmentation.networks.model import SegmentationModel
from sdm.segmentation.train.settings import Settings
from sdm.training.checkpoints import fitting_states

FORMAT = "sdm segmentation 1"
FIELDS: dict[str, Any] = {
    "format": str,
    "settings": dict[str, Any],
    "spacing": tuple[float, float, float],
    "weights": dict[str, Tensor],
}
NO_NETWORK = "is not a trained segmentation network"


@dataclass(frozen=True)
class TrainedModel:
    """A network, how it was trained, and the voxel size in mm of what it was trained on."""

    model: SegmentationModel
    settings: Settings
    spacing: tuple[float, float, float]


def save_model(trained: TrainedModel, path: Path) -> None:
    """Write the network, whole or not at all."""
    state = {
        "format": FORMAT,
        "settings": trained.settings.record(),
        "spacing": list(trained.spacing),
        "weights": {name: value.cpu().contiguous() for name, value in trained.model.state_dict().items()},
    }
    save_torch(state, path)


def load_model(path: Path, device: torch.device | str = "cpu") -> TrainedModel:
    """Read a network, ready to predict. The file is data alone: nothing in it is run.

    Raises:
        FormatError: There is no such file, or it is not one of `save_model`.
    """
    state = _state(path)
    settings = Settings.of_record(state["settings"], path)
    with fitting_states(path, NO_NETWORK):
        model = settings.network()
        model.load_state_dict(state["weights"])
    x, y, z = state["spacing"]
    return TrainedModel(model.to(device).eval(), settings, (x, y, z))


def load_settings(path: Path) -> Settings:
    """Settings by which the network of a file was trained; its weights are not read.

    Raises:
        FormatError: As `load_model`.
    """
    return Settings.of_record(_state(path, mmap=True)["settings"], path)


def _state(path: Path, *, mmap: bool = False) -> dict[str, Any]:
    if not path.is_file():
        raise FormatError(f"{path} is not there: give the model.pt that sdm train segmentation wrote")
    state = load_torch(path, NO_NETWORK, {"format": str}, mmap=mmap)
    if state["format"] != FORMAT:
        raise FormatError(f"{path} is a file of the kind {state['format']!r}, not {FORMAT!r}")
    check_record(state, FIELDS, path, NO_NETWORK)
    return state
