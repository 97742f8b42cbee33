"""Overloads of the public calls and the functions that they stand for: the same options with the same types."""

import inspect
import typing
from collections.abc import Callable
from typing import Any

import pytest

import sdm

CALLS = [
    sdm.signed_distance_map,
    sdm.signed_distance,
    sdm.signed_distance_maps,
    sdm.signed_distances,
    sdm.narrow_band,
    sdm.watertight,
    sdm.euclidean_distance_transform,
]
# Told apart by the overloads, so that their types differ from one to the next.
TOLD_APART = {"mesh", "meshes", "mask", "out", "grid", "points", "vertices", "faces", "return_closest", "return_report"}
TOLD_APART |= {"return_nearest", "return"}


def _options(overload: Callable[..., Any]) -> dict[str, Any]:
    """Types of all keyword arguments of an overload, with those that it unpacks."""
    hints = typing.get_type_hints(overload)
    names = dict(inspect.signature(overload).parameters)
    rest = [name for name, parameter in names.items() if parameter.kind is parameter.VAR_KEYWORD]
    found = {name: hints[name] for name in names if name not in rest}
    for name in rest:
        (unpacked,) = typing.get_args(hints[name])
        found |= typing.get_type_hints(unpacked)
    return found


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_overloads_have_the_options_of_the_call(call: Callable[..., Any]) -> None:
    overloads = typing.get_overloads(call)
    own = {name: kind for name, kind in typing.get_type_hints(call).items() if name not in TOLD_APART}
    assert len(overloads) >= 2
    seen: set[str] = set()
    for overload in overloads:
        found = _options(overload)
        seen |= set(found)
        for name in set(found) - TOLD_APART:
            assert found[name] == own[name], f"{name} of an overload of {call.__name__}"
    # None is left out by all.
    assert set(own) <= seen
