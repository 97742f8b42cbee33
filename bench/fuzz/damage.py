"""Ways to damage the bytes of a file."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four bits the other way."""
    damaged = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end gone: often a few bytes, sometimes much."""
    most = min(len(data), 12) if rng.random() < 0.5 else len(data)
    return data[: len(data) - int(rng.integers(1, most + 1))]


def without_middle(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch gone."""
    begin = int(rng.integers(len(data)))
    return data[:begin] + data[begin + int(rng.integers(1, 9)) :]


def inserted(data: bytes, rng: np.random.Generator) -> bytes:
    """Random bytes in between."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, 17))) + data[at:]


def repeated(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch twice."""
    begin = int(rng.integers(len(data)))
    end = min(len(data), begin + int(rng.integers(1, 65)))
    return data[:end] + data[begin:]


def other_number(data: bytes, rng: np.random.Generator) -> bytes:
    """A number in text replaced by a strange one."""
    found = list(re.finditer(rb"(?<![\w.])-?\d+(?:\.\d+)?", data))
    if not found:
        return flip(data, rng)
    number = found[rng.integers(len(found))]
    strange = [b"0", b"-1", b"1e300", b"nan", b"inf", b"99999999999", b"x", b"", b"0.5", b"2147483648"]
    return data[: number.start()] + strange[rng.integers(len(strange))] + data[number.end() :]


DAMAGES: dict[str, Damage] = {
    "flip": flip,
    "cut": cut,
    "without_middle": without_middle,
    "inserted": inserted,
    "repeated": repeated,
    "other_number": other_number,
}


def drawn(rng: np.random.Generator) -> tuple[str, Damage]:
    """One of them."""
    name = list(DAMAGES)[rng.integers(len(DAMAGES))]
    return name, DAMAGES[name]
