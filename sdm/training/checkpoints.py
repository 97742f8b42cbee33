"""Checkpoints: of one training at a time in a folder, refused where they are another's, never replaced unasked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import torch

from sdm.errors import FormatError, SDMError
from sdm.io.files.lock import alone
from sdm.training.training_settings import TrainingSettings


@contextmanager
def training_folder(folder: Path, *, lock: bool = True) -> Iterator[Path]:
    """Make a training's folder, and keep other trainings of this machine out of it until the end.

    Args:
        folder: Made if it is not there.
        lock: Of several processes of one training, only the first locks.

    Raises:
        FormatError: Another training has it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"the folder {folder} cannot be made: {error.strerror}") from error
    with alone(folder) if lock else nullcontext():
        yield folder


def refuse_unfinished(checkpoint: Path) -> None:
    """Refuse to begin a training where a checkpoint keeps an unfinished one.

    Raises:
        FormatError: It is there.
    """
    if checkpoint.exists():
        raise FormatError(f"{checkpoint} keeps an unfinished training: --resume goes on with it; or remove it")


def check_settings(kept: Any, wanted: TrainingSettings, checkpoint: Path) -> None:
    """Refuse to go on from the checkpoint of a training with other settings.

    Args:
        kept: The checkpoint's settings, as `TrainingSettings.record` or `identity` gave them.
        wanted: Those of the training that is to go on.
        checkpoint: The file.

    Raises:
        FormatError: They differ, or a newer sdm wrote them.
    """
    if type(wanted).of_record(kept, checkpoint).identity() != wanted.identity():
        raise FormatError(
            f"{checkpoint} is the checkpoint of a training with other settings: give those, or another file, or "
            "remove it to begin anew"
        )


@contextmanager
def fitting_states(path: Path, otherwise: str) -> Iterator[None]:
    """Load states of a file into networks, optimizers and averages within the block.

    Args:
        path: The file.
        otherwise: Words after its name where a state does not fit, such as "is not a trained network".

    Raises:
        FormatError: A state is of something else, or lacks a part.
    """
    try:
        yield
    # Torch's modules and optimizers raise all of these for states that are not theirs.
    except (RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        if isinstance(error, SDMError | torch.OutOfMemoryError):
            raise
        raise FormatError(f"{path} {otherwise}: what it keeps does not fit its settings") from error
