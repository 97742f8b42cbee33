"""The split of the left atria by its record: no near twins on two sides, none twice, and a record that is a must."""

from __future__ import annotations

import itertools

import pytest

from sdm import FormatError, TriangleMesh
from sdm.bench.deepsdf.shapes import Shapes
from sdm.bench.deepsdf.study import atria_split


def test_no_near_twins_are_on_two_sides() -> None:
    record = atria_split.read_record()
    parts = atria_split.split_of(record)
    number = {name: n for n, name in enumerate(record["names"])}
    assert len(record["names"]) == 80
    assert sum(map(len, parts.values())) == 79
    assert len(parts["test"]) >= 16
    assert len(parts["validation"]) >= 8
    for a, b in itertools.combinations(parts, 2):
        apart = min(record["distances_mm"][number[x]][number[y]] for x in parts[a] for y in parts[b])
        assert apart >= record["limit_mm"] == atria_split.LIMIT_MM


def test_one_shape_that_is_there_twice_counts_once() -> None:
    """0RZD and CMPX are one label, cut differently."""
    names = [n for part in atria_split.split_of(atria_split.read_record()).values() for n in part]
    assert sum(n.startswith(("0RZD", "CMPX")) for n in names) == 1


def test_a_small_record() -> None:
    far = 9.0
    matrix = [[far] * 30 for _ in range(30)]
    for i in range(30):
        matrix[i][i] = 0.0
    for i, j, d in ((0, 1, 0.0), (2, 3, 1.0), (3, 4, 1.0)):
        matrix[i][j] = matrix[j][i] = d
    record = {"names": [f"n{i:02}" for i in range(30)], "limit_mm": 1.3, "distances_mm": matrix}
    assert atria_split.groups_of(record)[:3] == [["n00"], ["n02", "n03", "n04"], ["n05"]]
    table = atria_split.table_of(record)
    assert "3 pairs nearer than 1.3 mm" in table
    assert "| n00, n01 | 0 | yes |" in table
    mesh = TriangleMesh([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "n00")
    with pytest.raises(FormatError, match="lack 29"):
        atria_split.split_atria(Shapes([mesh], []), record)
