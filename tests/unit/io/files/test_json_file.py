"""JSON files: whole, or what was there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sdm.errors import FormatError
from sdm.io.files.json_file import write_json


def test_what_is_there_stays_where_content_is_none_of_json(tmp_path: Path) -> None:
    path = tmp_path / "a report.json"
    write_json(path, {"a": [1, 2.5, None], "é": True})
    assert json.loads(path.read_text()) == {"a": [1, 2.5, None], "é": True}
    with pytest.raises(TypeError):
        write_json(path, {"a": {1, 2}})
    assert json.loads(path.read_text())["a"] == [1, 2.5, None]
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_place_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="make it first"):
        write_json(tmp_path / "none" / "report.json", {})
