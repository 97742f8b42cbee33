"""One trial of a fuzzer: its outcome, and when that is a finding."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from sdm.errors import SDMError

# A sentence that is longer than this is none.
LONGEST_SENTENCE = 600


class Finding(Exception):
    """Something came out that should not have: a wrong value, a traceback, a lost face."""


@dataclass(frozen=True)
class Outcome:
    """The end of a trial that found nothing.

    Args:
        kind: What was tried, such as a format and a kind of damage.
        refused: Whether the input was refused in one sentence.
    """

    kind: str
    refused: bool


@contextmanager
def one_sentence(kind: str) -> Iterator[list[Outcome]]:
    """Turn a refusal inside into an outcome, which is then in the list; any other exception is a finding."""
    outcome: list[Outcome] = []
    try:
        yield outcome
    except SDMError as error:
        text = str(error)
        if "\n" in text or not text.strip() or len(text) > LONGEST_SENTENCE:
            raise Finding(f"{kind}: refused, but not in one sentence: {text!r}") from error
        outcome.append(Outcome(kind, refused=True))
    except Finding:
        raise
    except MemoryError as error:
        raise Finding(f"{kind}: out of memory") from error
    except Exception as error:
        raise Finding(f"{kind}: {type(error).__name__}: {error}") from error
