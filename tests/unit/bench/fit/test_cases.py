"""The table of cases goes on where an earlier window ended."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sdm.bench.fit.cases import _done
from sdm.errors import SDMError


def test_goes_on_from_cases_of_a_machine_like_this(tmp_path: Path) -> None:
    out, machine = tmp_path / "race.json", {"device": "a processor", "cores": 16}
    assert _done(out, ["exact"], machine) == set()
    rows = [{"case": 1, "exact": {}, "libigl-closest": {}}, {"case": 2, "exact": {}}]
    out.write_text(json.dumps({"cases": rows, "machine": {**machine, "commit": "another"}}))
    assert _done(out, ["exact", "libigl-closest"], machine) == {1}
    assert _done(out, ["exact"], machine) == {1, 2}
    with pytest.raises(SDMError, match="another machine"):
        _done(out, ["exact"], {**machine, "cores": 2})
