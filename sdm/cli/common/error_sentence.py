"""A user's errors, as one sentence each."""

from __future__ import annotations


def sentence_of(error: BaseException) -> str | None:
    """An error in one sentence, if a user can do something about it; None for mistakes in this program."""
    from sdm.errors import SDMError

    if isinstance(error, SDMError):
        return " ".join(str(error).split())
    # The allocators of torch raise this class, which cannot be named before torch is imported.
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError" or _is_full_host(error):
        return "there is not enough memory: choose a lower resolution or a smaller batch"
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    return None


def _is_full_host(error: BaseException) -> bool:
    # Of the host's memory torch says so by no class of its own.
    return isinstance(error, RuntimeError) and "DefaultCPUAllocator" in str(error)
