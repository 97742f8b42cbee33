"""Folder of a family's surrogate: weights as safetensors, and what they are as JSON. Nothing in it is run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, MeshError, SDMError
from sdm.io.files.atomic import replacing
from sdm.io.files.json_file import write_json
from sdm.io.files.typed_record import check_record
from sdm.stream.sample_maker import grid_record
from sdm.surrogate.families.low_rank import LowRankSurrogate
from sdm.surrogate.infer.runtime import Run, runner
from sdm.training.checkpoints import fitting_states

WEIGHTS, RECORD, VERSION = "surrogate.safetensors", "surrogate.json", 1
FIELDS: dict[str, Any] = {
    "version": int,
    "config": dict[str, Any],
    "grid": dict[str, Any],
    "family": dict[str, Any],
    "parameters": list[tuple[str, float, float, str]],
}
NO_SURROGATE = "is no surrogate that sdm train sdmnn --family wrote, or it is damaged"


def save_family_surrogate(
    model: LowRankSurrogate, grid: Grid, family: dict[str, Any], folder: Path, **facts: Any
) -> None:
    """Write a surrogate into a folder.

    Args:
        model: Trained.
        grid: Where it answers.
        family: By `sdm.shapes.family_record`.
        folder: Is there.
        facts: More for the record.
    """
    from safetensors.torch import save

    # Modes as float16, which keeps them to a two-thousandth; all else is small.
    tensors = {k: (v.half() if k == "modes" else v).contiguous() for k, v in model.state_dict().items()}
    record = {
        "version": VERSION,
        "config": model.config,
        "grid": grid_record(grid),
        "family": family,
        "parameters": family["parameters"],
        **facts,
    }
    with replacing(folder / WEIGHTS) as part:
        part.write_bytes(save(tensors))
    write_json(folder / RECORD, record)


class FamilyPredictor:
    """A family's surrogate from its folder, ready to answer on a CPU.

    Args:
        folder: That `sdm train sdmnn --family` wrote.
        backend: "torch", "onnxruntime" or "openvino".

    Raises:
        FormatError: It is not there, or is not one of these.
    """

    def __init__(self, folder: Path | str, *, backend: str = "torch") -> None:
        self.model, self.grid, self.record = load_family_surrogate(Path(folder))
        self.parameters = [tuple(p) for p in self.record["parameters"]]
        self._run: Run = runner(self.model, backend)

    def predict(self, theta: Any) -> SDM:
        """The map of one theta (P,).

        Raises:
            MeshError: Another number of parameters, or one outside the box that the surrogate was trained on.
        """
        values = torch.as_tensor(theta, dtype=torch.float32, device="cpu")
        if values.shape != (len(self.parameters),):
            raise MeshError(f"theta has shape {tuple(values.shape)}; this surrogate takes ({len(self.parameters)},)")
        for (name, low, high, _), value in zip(self.parameters, values.tolist(), strict=True):
            if not low - 1e-6 * abs(low) <= value <= high + 1e-6 * abs(high):
                raise MeshError(f"{name} is {value:g}; the surrogate was trained from {low:g} to {high:g}")
        return SDM(self.maps(values[None])[0, 0], self.grid)

    def maps(self, theta: Tensor) -> Tensor:
        """Maps (B,1,nx,ny,nz) of theta (B,P), which are not checked."""
        return self._run(theta.cpu())


def load_family_surrogate(folder: Path) -> tuple[LowRankSurrogate, Grid, dict[str, Any]]:
    """Model, grid and record of a folder.

    Raises:
        FormatError: It is not there, or is not one of these.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    if folder.name in (WEIGHTS, RECORD) and not folder.is_dir():
        raise FormatError(f"{folder} is a file of a surrogate: give the folder that it is in, {folder.parent}")
    if folder.is_file():
        raise FormatError(f"{folder} is a file: give the folder that sdm train sdmnn --family wrote")
    try:
        record = json.loads((folder / RECORD).read_text())
        packed = load((folder / WEIGHTS).read_bytes())
    except OSError as error:
        raise FormatError(f"{error.filename or folder} cannot be read: {error.strerror or error}") from error
    except (SafetensorError, RecursionError, ValueError) as error:
        raise FormatError(f"{folder} {NO_SURROGATE}") from error
    if not isinstance(record, dict):
        raise FormatError(f"{folder} {NO_SURROGATE}: {RECORD} holds no table")
    check_record(record, FIELDS, folder / RECORD, NO_SURROGATE)
    if record["version"] != VERSION:
        raise FormatError(f"{folder} holds a surrogate of another version of sdm; train it again")
    with fitting_states(folder, NO_SURROGATE):
        model = LowRankSurrogate(**record["config"])
        model.load_state_dict({name: v.float() for name, v in packed.items()})
    try:
        grid = Grid(**record["grid"])
    except (SDMError, TypeError) as error:
        raise FormatError(f"{folder} {NO_SURROGATE}: its grid makes no sense") from error
    if tuple(grid.shape) != tuple(model.config["shape"]) or len(record["parameters"]) != len(model.config["low"]):
        raise FormatError(f"{folder} {NO_SURROGATE}: grid, parameters and weights do not fit together")
    return model.eval().requires_grad_(False), grid, record
