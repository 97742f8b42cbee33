"""Commands of a command: `sdm train NAME`, `sdm family NAME`, prepared by their parser and run later."""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib import import_module
from typing import Annotated, Any, Union

import tyro


def union_of(names: dict[str, str]) -> Any:
    """A type whose parser takes one of these names and the function's typed arguments.

    Args:
        names: Name to "module:function". The docstring is the help; the module is imported for it, so it imports torch
            and the like inside the function.
    """
    members = (Annotated[Any, tyro.conf.subcommand(name=name, constructor=_later(names[name]))] for name in names)
    # A union has at least two members, so that a hidden one goes with a command that is alone.
    return Union[(*members, Annotated[None, tyro.conf.Suppress])]


def _later(place: str) -> Callable[..., Callable[[], int | None]]:
    """A function that prepares a command from its options and does not run it yet."""
    module, function = place.split(":")
    command = getattr(import_module(module), function)

    @functools.wraps(command)
    def prepare(*args: Any, **kwargs: Any) -> Callable[[], int | None]:
        return functools.partial(command, *args, **kwargs)

    return prepare
