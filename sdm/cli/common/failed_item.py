"""Failed items of a folder: which end the command, and what is told of the others."""

from __future__ import annotations

import errno

from sdm.cli.common.error_sentence import sentence_of
from sdm.errors import FormatError
from sdm.runtime.pipeline.outcome import Failed

# A quota that is used up, and files that may not grow, are the same to who writes.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def reason_of(failed: Failed, *, alone: bool = False) -> str:
    """The sentence that is told of an item, while the others go on.

    Args:
        failed: What became of it.
        alone: It is the only one, so that its error is that of the command.

    Raises:
        FormatError: The disk is full, which every other item would fail by, too.
        Exception: What is no user's mistake, or the error of an item that is alone.
    """
    sentence = sentence_of(failed.error)
    if sentence is None or alone:
        raise failed.error
    if _is_full_disk(failed.error):
        raise FormatError(f"{sentence}; --resume goes on from there") from failed.error
    return sentence


def _is_full_disk(error: BaseException | None) -> bool:
    """True if an error, or one that it came from, says that there is no room."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL:
            return True
        error = error.__cause__
    return False
