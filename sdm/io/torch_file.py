"""Files of torch: whole, or one sentence about why not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from sdm.io.atomic import replacing


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


def _cause(error: BaseException) -> BaseException:
    """What the file said, behind what torch's writer says as it gives up; else the error itself."""
    before: BaseException | None = error
    while before is not None:
        if isinstance(before, OSError):
            return before
        before = before.__context__
    return error
