"""Failed items of a folder: which end the command, and what is told of the others."""

from __future__ import annotations

import errno

from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.printed_line import print_line, printable
from sdm.errors import FormatError
from sdm.runtime.pipeline.outcome import Failed

# A quota that is used up, and files that may not grow, are the same to who writes.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def reason_of(failed: Failed, *, alone: bool = False, resumed: bool = True) -> str:
    """The sentence that is told of an item, while the others go on.

    Args:
        failed: What became of it.
        alone: It is the only one, so that its error is that of the command.
        resumed: Whether the command has --resume.

    Raises:
        FormatError: The disk is full, which every other item would fail by, too.
        Exception: What is no user's mistake, or the error of an item that is alone.
    """
    sentence = sentence_of(failed.error)
    if sentence is None or alone:
        raise failed.error
    if _is_full_disk(failed.error):
        raise FormatError(f"{sentence}; --resume goes on from there" if resumed else sentence) from failed.error
    return sentence


def tell_failed(failed: list[tuple[str, str]], total: int, one: str, many: str) -> int | None:
    """Say which items failed, on stderr; the exit code.

    Args:
        failed: Name and sentence of each.
        total: How many items there were.
        one: What an item is called, and `many` of several.
        many: Several.
    """
    for name, reason in failed:
        # Most sentences name the file already.
        print_line(f"sdm: {reason if printable(name) in reason else f'{name}: {reason}'}", error=True)
    if failed:
        others = "; the others are done" if len(failed) < total else ""
        of_all = f"{len(failed)} of {total} {many}" if total > 1 else f"the only {one}"
        print_line(f"sdm: {of_all} failed{others}", error=True)
    return 2 if failed else None


def _is_full_disk(error: BaseException | None) -> bool:
    """True if an error, or one that it came from, says that there is no room."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL:
            return True
        error = error.__cause__
    return False
