"""Messages of other libraries, fit for the middle of a sentence."""

from __future__ import annotations

LONGEST = 200


def one_line(message: object) -> str:
    """A message on one line, cut where it grows long; of an error without one, its name."""
    text = " ".join(str(message).split()).rstrip(".")
    if not text and isinstance(message, BaseException):
        text = type(message).__name__
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
