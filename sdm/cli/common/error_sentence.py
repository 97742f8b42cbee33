"""A user's errors, as one sentence each."""

from __future__ import annotations

import traceback

from sdm.cli.common.printed_line import printable


def sentence_of(error: BaseException) -> str | None:
    """An error in one sentence, if a user can do something about it; None for mistakes in this program."""
    from sdm.errors import SDMError

    if isinstance(error, SDMError):
        # Its package imports what a mistyped command needs none of.
        from sdm.io.files.stand_in import shown

        return printable(shown(str(error).strip()))
    # The allocators of torch raise this class, which cannot be named before torch is imported.
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError" or _is_full_host(error):
        return "there is not enough memory: choose a lower resolution or a smaller batch"
    if isinstance(error, OSError):
        if _is_of_warp(error):
            where = f" in {error.filename}" if error.filename else ""
            return (
                f"compiled kernels cannot be kept{where} ({error.strerror or error}): "
                "name a folder that can be written, and has some 100 MB free, by WARP_CACHE_PATH"
            )
        where = f"{error.filename}: " if error.filename else ""
        return printable(f"{where}{error.strerror or error}")
    return None


def _is_of_warp(error: OSError) -> bool:
    """True if Warp raised it, which reads and writes no files but those of its kernel cache."""
    frames = traceback.walk_tb(error.__traceback__)
    return any(frame.f_globals.get("__name__", "").partition(".")[0] == "warp" for frame, _ in frames)


def _is_full_host(error: BaseException) -> bool:
    # Of the host's memory torch says so by no class of its own.
    return isinstance(error, RuntimeError) and "DefaultCPUAllocator" in str(error)
