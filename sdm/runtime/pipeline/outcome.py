"""Outcome of a stage for one item: a value, or the error that took its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Done(Generic[T]):
    """An item that went well so far.

    Args:
        number: Its place among the items, from 0.
        value: What the last stage made of it.
    """

    number: int
    value: T


@dataclass(frozen=True)
class Failed:
    """An item that a stage could not do; later stages pass it on.

    Args:
        number: Its place among the items, from 0.
        error: What that stage raised.
    """

    number: int
    error: Exception
