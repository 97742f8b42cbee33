"""Weights of surrogates as files: safetensors, with what they are beside them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from sdm.core.device import device_to_hold
from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.files.json_file import write_json
from sdm.io.files.typed_record import check_record
from sdm.shapes import families, make_family
from sdm.stream.sample_maker import grid_record
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.networks.models import build, name_of
from sdm.training.checkpoints import fitting_states

VERSION = 1
FIELDS: dict[str, Any] = {
    "version": int,
    "model": str,
    "config": dict[str, Any],
    "grid": dict[str, Any],
    "parameters": list[tuple[str, float, float, str]],
    "family": str,
}
NO_SURROGATE = "is not a surrogate that sdm wrote, or it is damaged"
# Tensors of at most this many numbers stay float32; larger ones become float16.
SMALL = 16_384
# Of a table of modes, these first rows (the largest) become float16, the others 8-bit with a scale each.
FINE_ROWS = 24
WHOLE = 127.0
# Root mean square of normal numbers for a mean absolute value of 1.
RMS_OF_MEAN = math.sqrt(math.pi / 2)


def save_weights(model: nn.Module, target: Path, **facts: Any) -> None:
    """Write NAME.safetensors and NAME.json beside it.

    Args:
        model: A surrogate.
        target: Path of NAME.safetensors.
        facts: More for the JSON file, for example errors and how it was trained.
    """
    from safetensors.torch import save

    tensors: dict[str, Tensor] = {}
    for name, value in model.state_dict().items():
        tensors.update(_pack(name, value.detach().cpu()))
    config = {
        "version": VERSION,
        "model": name_of(model),
        "config": model.config,
        "grid": grid_record(GRID),
        "parameters": [[p.name, p.low, p.high, p.unit] for p in families["cochlea"].parameters],
        "family": make_family("cochlea").fingerprint,
        **facts,
    }
    with replacing(target) as part:
        part.write_bytes(save(tensors))
    write_json(target.with_suffix(".json"), config)


def load_weights(source: Path, device: torch.device | str = "cpu") -> tuple[nn.Module, dict[str, Any]]:
    """The surrogate in a file, in evaluation mode, and what its JSON file says.

    Raises:
        FormatError: A file that is not there, or not one of these.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    # An empty path, a dot and the root.
    if not source.name:
        raise FormatError(f"{source} cannot be read: it is a folder; give a file that sdm train sdmnn wrote")
    # Asked of the weights first, so that the message names what was given and not the file beside it.
    if not source.is_file():
        raise FormatError(f"{source} cannot be read: no such file; give a .safetensors that sdm train sdmnn wrote")
    if source.suffix == ".json" or not source.with_suffix(".json").is_file():
        raise FormatError(f"{source} {NO_SURROGATE}: a .safetensors file with its .json beside it is needed")
    try:
        config = json.loads(source.with_suffix(".json").read_text())
        packed = load(source.read_bytes())
    except OSError as error:
        raise FormatError(f"{error.filename or source} cannot be read: {error.strerror or error}") from error
    except (SafetensorError, RecursionError, ValueError) as error:
        raise FormatError(f"{source} {NO_SURROGATE}") from error
    if not isinstance(config, dict):
        raise FormatError(f"{source} {NO_SURROGATE}: {source.with_suffix('.json').name} holds no table")
    check_record(config, FIELDS, source.with_suffix(".json"), NO_SURROGATE)
    if config["version"] != VERSION or config["grid"] != grid_record(GRID):
        raise FormatError(f"{source} holds a surrogate for another grid or version of sdm; train it again")
    with fitting_states(source, NO_SURROGATE):
        model = build(config["model"], **config["config"])
        model.load_state_dict(_unpack(packed))
    return model.eval().requires_grad_(False).to(device_to_hold(device)), config


def near_error(facts: dict[str, Any]) -> float | None:
    """Root mean square error of a surrogate's maps near the surface, in its unit of length.

    Args:
        facts: The record beside its weights, or the card of a family's surrogate (`card.json`). Both have mean absolute
            errors; the ratio of the two is taken to be that of normal errors.

    Returns:
        None where nothing is recorded.
    """
    mean = facts.get("errors", {}).get("mae_near_mm", facts.get("near"))
    return RMS_OF_MEAN * mean if isinstance(mean, int | float) else None


def training_of(source: Path) -> dict[str, Any]:
    """Settings and length of the training of some weights, by their JSON file, and of those that it began from."""
    facts = json.loads(source.with_suffix(".json").read_text())
    before = {"started_from": facts["started_from"]} if "started_from" in facts else {}
    return {**facts.get("training", {}), **before}


def _pack(name: str, value: Tensor) -> dict[str, Tensor]:
    if name == "modes" and value.shape[0] > FINE_ROWS:
        fine, coarse = value[:FINE_ROWS], value[FINE_ROWS:].float()
        scale = coarse.abs().amax(1, keepdim=True).clamp_min(1e-12) / WHOLE
        return {
            f"{name}.fine": fine.half(),
            f"{name}.whole": (coarse / scale).round().to(torch.int8),
            f"{name}.scale": scale,
        }
    if value.is_floating_point() and value.numel() > SMALL:
        return {name: value.half().contiguous()}
    return {name: value.contiguous()}


def _unpack(packed: dict[str, Tensor]) -> dict[str, Tensor]:
    state = {name: v.float() if v.is_floating_point() else v for name, v in packed.items()}
    for name in [n.removesuffix(".whole") for n in packed if n.endswith(".whole")]:
        fine, whole, scale = (state.pop(f"{name}.{part}") for part in ("fine", "whole", "scale"))
        state[name] = torch.cat([fine, whole.float() * scale])
    return state
