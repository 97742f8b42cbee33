"""Lines on the terminal: control characters, which names of files may have, as escapes; numbers with their nouns."""

from __future__ import annotations

import re
import sys

# Of ASCII and Latin-1, and the separators of lines and paragraphs.
CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")


def printable(text: object) -> str:
    r"""A text on one line that moves no cursor and changes no colour: a new line in it becomes the two letters \n."""
    return CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def counted(number: int, one: str, more: str | None = None) -> str:
    """A number with its noun: 1 mesh, 2,000 meshes; by default the plural of `one` ends in s."""
    return f"1 {one}" if number == 1 else f"{number:,} {more or one + 's'}"


def print_line(text: object, *, error: bool = False) -> None:
    """Print one line on stdout, or on stderr, at once."""
    print(printable(text), file=sys.stderr if error else sys.stdout, flush=True)
