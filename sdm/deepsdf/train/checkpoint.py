"""DeepSDF's files: a model that users load, and what a training needs besides to go on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.files.torch_file import load_torch, save_torch

KIND = "sdm-deepsdf"
VERSION = 1
# The folder of an unfinished training in that of its model.
CHECKPOINT = "checkpoint"
MODEL, OPTIMIZER = "model.pt", "optimizer.pt"
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


def refuse_unfinished(folder: Path) -> None:
    """Refuse to begin a training in a folder whose checkpoint is of one that has not come to its model.

    Raises:
        FormatError: Names the checkpoint.
    """
    last = folder / CHECKPOINT
    if last.exists() and not _finished(folder / MODEL, last / MODEL):
        raise FormatError(f"{last} keeps an unfinished training: --resume goes on with it; or remove it")


def _finished(model: Path, last: Path) -> bool:
    """Whether a model is what its training's last checkpoint holds: it may be that of an earlier training."""
    try:
        found, kept = read(model), read(last)
    except FormatError:
        return False
    # Seconds are of a clock, and so tell trainings of equal settings apart.
    return all(found.get(name) == kept.get(name) for name in ("settings", "names", "step", "seconds"))


def shipped() -> dict[str, Path]:
    """Models that come with the package, by name."""
    return {path.stem: path for path in sorted(WEIGHTS.glob("*.pt"))}


def read(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a file that `write` wrote; no code in it is run.

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
    content = load_torch(path, "is no DeepSDF model, or it is damaged; train it again", device=device)
    if content.get("kind") != KIND:
        raise FormatError(f"{path} is no DeepSDF model; give a file that sdm train deepsdf wrote")
    if content.get("version") != VERSION:
        raise FormatError(
            f"{path} is a DeepSDF model of version {content.get('version')}, and this program reads version {VERSION}; "
            "train it again, or use the sdm that wrote it"
        )
    return content
