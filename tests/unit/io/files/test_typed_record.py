"""Values of files against the types that they should have."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import pytest
import torch

from sdm.errors import FormatError
from sdm.io.files.typed_record import as_type, check_record


@pytest.mark.parametrize(
    ("value", "hint", "expected"),
    [
        (1, int, 1),
        (1, float, 1),
        (True, bool, True),
        (None, None, None),
        (None, float | None, None),
        (2.5, float | None, 2.5),
        ("a", Literal["a", "b"], "a"),
        ([1, 2, 3], tuple[int, int, int], (1, 2, 3)),
        ([[1, 2], (3, 4)], tuple[tuple[int, int], ...], ((1, 2), (3, 4))),
        ([], tuple[int, ...], ()),
        ([1, 2], list[float], [1, 2]),
        ({"a": 1}, dict[str, int], {"a": 1}),
        ({"a": object}, dict[str, Any], {"a": object}),
    ],
)
def test_values_of_their_type(value, hint, expected):
    found = as_type(value, hint)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        (1.0, int),
        ("1", int),
        (True, int),
        (True, float),
        (0, bool),
        (None, int),
        ("x", float | None),
        ("c", Literal["a", "b"]),
        ([1, 2], tuple[int, int, int]),
        (3, tuple[int, ...]),
        ("ab", list[str]),
        ((1,), list[int]),
        ({1: 1}, dict[str, int]),
        ([1], dict[str, int]),
        (1, torch.Tensor),
    ],
)
def test_values_of_another_type(value, hint):
    with pytest.raises(TypeError):
        as_type(value, hint)


def test_a_record_may_have_more_keys_but_no_fewer():
    fields = {"a": int, "b": torch.Tensor}
    check_record({"a": 1, "b": torch.zeros(1), "c": 3}, fields, Path("f.pt"), "is no file")
    with pytest.raises(FormatError, match=r"f\.pt is no file: it has no 'b'"):
        check_record({"a": 1}, fields, Path("f.pt"), "is no file")
    with pytest.raises(FormatError, match=r"f\.pt is no file: its 'a' is not of the right kind"):
        check_record({"a": "1", "b": torch.zeros(1)}, fields, Path("f.pt"), "is no file")
