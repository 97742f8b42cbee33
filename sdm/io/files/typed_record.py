"""Records of files: dictionaries whose keys and types are known beforehand."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from sdm.errors import FormatError


def check_record(record: Mapping[str, Any], fields: Mapping[str, Any], path: Path, otherwise: str) -> None:
    """Refuse a record that lacks a key, or whose value is of another type.

    Args:
        record: As it was read; it may have more keys.
        fields: Type of each key, as `as_type` takes them.
        path: The file.
        otherwise: Words after the file's name, such as "is not a trained network".

    Raises:
        FormatError: Names the file and the key.
    """
    for name, hint in fields.items():
        if name not in record:
            raise FormatError(f"{path} {otherwise}: it has no {name!r}")
        try:
            as_type(record[name], hint)
        except TypeError as error:
            raise FormatError(f"{path} {otherwise}: its {name!r} is not of the right kind") from error


def as_type(value: Any, hint: Any) -> Any:
    """Value as its type says: lists, which are what JSON has, become tuples where the type is one.

    Args:
        value: Anything that JSON or torch's reader gives.
        hint: A class, `Any`, a `Literal`, a union, or `tuple`, `list` or `dict` of them. Whole numbers are floats too;
            truth values are no numbers.

    Raises:
        TypeError: It is something else.
    """
    if hint is Any or (value is None and (hint is None or hint is NoneType)):
        return value
    if get_origin(hint) is not None:
        return _as_generic(value, hint, get_args(hint))
    # A truth value is a whole number to Python.
    mixed_up = isinstance(value, bool) != (hint is bool)
    if mixed_up or not isinstance(value, (int, float) if hint is float else hint):
        raise TypeError(f"{value!r} is not {hint}")
    return value


def _as_generic(value: Any, hint: Any, inner: tuple[Any, ...]) -> Any:
    origin = get_origin(hint)
    if origin is Literal and value in inner:
        return value
    if origin in (Union, UnionType):
        for one in inner:
            with suppress(TypeError):
                return as_type(value, one)
    elif origin is tuple and isinstance(value, list | tuple):
        kinds = [inner[0]] * len(value) if inner[1:] == (...,) else list(inner)
        if len(kinds) == len(value):
            return tuple(as_type(item, kind) for item, kind in zip(value, kinds, strict=True))
    elif origin is list and isinstance(value, list):
        return [as_type(item, inner[0]) for item in value]
    elif origin is dict and isinstance(value, dict):
        return {as_type(key, inner[0]): as_type(item, inner[1]) for key, item in value.items()}
    raise TypeError(f"{value!r} is not {hint}")
