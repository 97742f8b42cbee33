"""Files of torch: whole, or one sentence about why not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from sdm.errors import FormatError
from sdm.io.files.atomic import replacing


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


def load_torch(path: Path, otherwise: str, *, device: torch.device | str = "cpu", mmap: bool = False) -> dict[str, Any]:
    """The dictionary in a file of torch's; no code in it is run.

    Args:
        path: The file.
        otherwise: What is said, after its name, of one that is damaged or something else.
        device: Where tensors go.
        mmap: Read tensors only when they are used.

    Raises:
        FormatError: It is not there, is damaged, or holds no dictionary.
    """
    try:
        content = torch.load(path, map_location=device, weights_only=True, mmap=mmap)
    except (MemoryError, torch.OutOfMemoryError):
        raise
    # Of bytes that are not its own torch's reader raises whatever it comes across.
    except Exception as error:
        raise FormatError(f"{path} {otherwise}") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path} {otherwise}")
    return content


@contextmanager
def own_settings(path: Path) -> Iterator[None]:
    """Settings are made of what a file has, which a newer sdm may have written.

    Raises:
        FormatError: There is one that this sdm does not have.
    """
    try:
        yield
    except TypeError as error:
        raise FormatError(f"{path} has settings that this program does not know: use the sdm that wrote it") from error


def _cause(error: BaseException) -> BaseException:
    """What the file said, behind what torch's writer says as it gives up; else the error itself."""
    before: BaseException | None = error
    while before is not None:
        if isinstance(before, OSError):
            return before
        before = before.__context__
    return error
