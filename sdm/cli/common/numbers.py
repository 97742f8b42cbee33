"""Arguments of one number or three: `64`, `64 64 32` or `64,64,32`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import tyro

# Options whose numbers may be several words.
SEVERAL = ("--resolution", "--spacing", "--classes")
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)


def joined(words: Sequence[str]) -> list[str]:
    """The words of a command line, with numbers that follow one of these options as one word.

    So the option takes one word always, and a mesh after it is not taken for a number.
    """
    found: list[str] = []
    collecting = False
    for word in words:
        follows = bool(found) and found[-1] in SEVERAL
        if NUMBER.fullmatch(word) and collecting and not follows:
            found[-1] += f",{word}"
        else:
            collecting = follows and NUMBER.fullmatch(word) is not None
            found.append(word)
    return found


def numbers(kind: Callable[[str], Any], metavar: str) -> Any:
    """The constructor of an option of one number or three, or of None where it is not given."""

    def parsed(words: list[str]) -> tuple[Any, ...]:
        return tuple(kind(part) for part in words[0].replace(" ", "").split(","))

    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=parsed,
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda value: ["none" if value is None else ",".join(map(str, value))],
    )
