"""Files of torch: whole, or one sentence about why not."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from sdm.errors import FormatError
from sdm.io.files.atomic import replacing
from sdm.io.files.typed_record import check_record


def save_torch(state: Any, path: Path) -> None:
    """`torch.save`, atomically.

    Raises:
        FormatError: The folder is not there, or cannot be written, or the disk is full.
    """
    # A file of Python's: torch's own says of a full disk only where in the file it was.
    with replacing(path) as part, part.open("wb") as file:
        try:
            torch.save(state, file)
        except RuntimeError as error:
            raise _cause(error) from None


def load_torch(
    path: Path,
    otherwise: str,
    fields: Mapping[str, Any] | None = None,
    *,
    device: torch.device | str = "cpu",
    mmap: bool = False,
) -> dict[str, Any]:
    """The dictionary in a file of torch's; no code in it is run.

    Args:
        path: The file.
        otherwise: Words after its name where it is damaged or something else.
        fields: Keys that it must have, with their types: see `check_record`.
        device: Where tensors go.
        mmap: Read tensors only when they are used.

    Raises:
        FormatError: It is not there, is damaged, holds no dictionary, or lacks a key.
    """
    try:
        with warnings.catch_warnings():
            # Of a pickle that is not torch's own it warns before it refuses it.
            warnings.simplefilter("ignore")
            content = torch.load(path, map_location=device, weights_only=True, mmap=mmap)
    except (MemoryError, torch.OutOfMemoryError):
        raise
    # Of bytes that are not its own torch's reader raises whatever it comes across.
    except Exception as error:
        raise FormatError(f"{path} {otherwise}") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path} {otherwise}")
    check_record(content, fields or {}, path, otherwise)
    return content


def _cause(error: BaseException) -> BaseException:
    """Error of the file, behind what torch's writer says as it gives up; else the error itself."""
    before: BaseException | None = error
    while before is not None:
        if isinstance(before, OSError):
            return before
        before = before.__context__
    return error
