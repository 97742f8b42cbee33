"""Messages of other libraries, fit for the middle of a sentence."""

from __future__ import annotations

LONGEST = 200


def one_line(message: object) -> str:
    """A message on one line, cut where it grows long."""
    text = " ".join(str(message).split()).rstrip(".")
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
