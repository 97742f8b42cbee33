"""Warnings about maps: whom they name, whether this thread wants any, and what they begin with."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdm.errors import SDMWarning

PACKAGE = str(Path(__file__).parents[2])


class _Warnings(threading.local):
    are_off: bool = False
    prefix: str = ""


state = _Warnings()


@contextmanager
def quiet() -> Iterator[None]:
    """Maps that this thread makes meanwhile are not checked."""
    before, state.are_off = state.are_off, True
    try:
        yield
    finally:
        state.are_off = before


@contextmanager
def named(prefix: str) -> Iterator[None]:
    """Warnings about maps that this thread makes meanwhile begin with this."""
    before, state.prefix = state.prefix, prefix
    try:
        yield
    finally:
        state.prefix = before


def warn(message: str) -> None:
    """Warn whoever called the library, wherever in it this is."""
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, SDMWarning, stacklevel=level)
