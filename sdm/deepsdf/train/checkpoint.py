"""Files of DeepSDF: a model that users load, and the optimizer's state that a training goes on with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.files.torch_file import load_torch, save_torch
from sdm.io.files.typed_record import check_record
from sdm.training.checkpoints import refuse_unfinished

KIND = "sdm-deepsdf"
VERSION = 1
# The folder of an unfinished training in that of its model.
CHECKPOINT = "checkpoint"
MODEL, OPTIMIZER = "model.pt", "optimizer.pt"
MODEL_FIELDS: dict[str, Any] = {
    "settings": dict[str, Any],
    "names": list[str],
    "spheres": list[tuple[float, float, float, float]],
    "state": dict[str, Tensor],
    "step": int,
    "seconds": float,
    "history": list[tuple[int, float, float]],
}
OPTIMIZER_FIELDS: dict[str, Any] = {"state": dict[str, Any], "step": int}
DAMAGED = "is no DeepSDF model, or it is damaged; train it again"
WEIGHTS = Path(__file__).parents[1] / "weights"


def write(content: dict[str, Any], path: Path) -> None:
    """Write one file, atomically, with its kind and version."""
    save_torch({"kind": KIND, "version": VERSION, **content}, path)


def write_both(model: dict[str, Any], optimizer: dict[str, Any], folder: Path) -> None:
    """Write a checkpoint: a folder with a model and its optimizer's state, replaced as one."""
    with replacing(folder) as part:
        part.mkdir()
        write(model, part / MODEL)
        write(optimizer, part / OPTIMIZER)


def refuse_unfinished_in(folder: Path) -> None:
    """Refuse to begin a training in a folder whose checkpoint is of one that has not come to its model.

    Raises:
        FormatError: Names the checkpoint.
    """
    last = folder / CHECKPOINT
    if not _finished(folder / MODEL, last / MODEL):
        refuse_unfinished(last)


def _finished(model: Path, last: Path) -> bool:
    """True if a model is what its training's last checkpoint holds: it may be that of an earlier training."""
    try:
        found, kept = read_model(model), read_model(last)
    except FormatError:
        return False
    # Seconds are of a clock, and so tell trainings of equal settings apart.
    return all(found.get(name) == kept.get(name) for name in ("settings", "names", "step", "seconds"))


def shipped() -> dict[str, Path]:
    """Models that come with the package, by name."""
    return {path.stem: path for path in sorted(WEIGHTS.glob("*.pt"))}


def read_model(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a model: a file that a training wrote, its folder, or the name of one that comes with the package.

    Raises:
        FormatError: It is not there, is something else, is damaged, or is of another version.
    """
    if path.is_dir():
        path = path / MODEL
    elif not path.exists():
        path = shipped().get(str(path), path)
    if not path.exists():
        raise FormatError(
            f"{path} is not there; train a model first, or give another file or a name ({', '.join(shipped())})"
        )
    content = _read(path, device)
    if not content.keys() & {"settings", "names"} and content.keys() >= OPTIMIZER_FIELDS.keys():
        raise FormatError(f"{path} is the state of a training's optimizer; give the {MODEL} beside it")
    check_record(content, MODEL_FIELDS, path, DAMAGED)
    if len(content["names"]) != len(content["spheres"]):
        raise FormatError(f"{path} {DAMAGED}: it has {len(content['names'])} names, {len(content['spheres'])} spheres")
    return content


def read_optimizer(folder: Path) -> dict[str, Any]:
    """Read the state of the optimizer of a checkpoint, to the host.

    Raises:
        FormatError: As `read_model`.
    """
    path = folder / OPTIMIZER
    content = _read(path, "cpu")
    check_record(content, OPTIMIZER_FIELDS, path, DAMAGED)
    return content


def _read(path: Path, device: torch.device | str) -> dict[str, Any]:
    content = load_torch(path, DAMAGED, device=device)
    if content.get("kind") != KIND:
        raise FormatError(f"{path} is no DeepSDF model; give a file that sdm train deepsdf wrote")
    if content.get("version") != VERSION:
        raise FormatError(
            f"{path} is a DeepSDF model of version {content.get('version')}, and this program reads version {VERSION}; "
            "train it again, or use the sdm that wrote it"
        )
    return content
