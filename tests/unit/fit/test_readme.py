"""The sample on the fit's page runs, and the options it names are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

FENCE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_sample_runs(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (sample,) = FENCE.findall((root / "sdm" / "fit" / "README.md").read_text())
    namespace: dict[str, object] = {}
    exec(compile(sample, "sample", "exec"), namespace)
    result = namespace["result"]
    assert result.trusted  # type: ignore[attr-defined]
    assert "tensor" in capsys.readouterr().out


def test_options_of_the_page_are_there(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from sdm.cli import main

    page = (root / "sdm" / "fit" / "README.md").read_text()
    assert main(["fit", "--help"]) == 0
    said = capsys.readouterr().out
    for word in ("--mesh", "--picture"):
        assert word in page
        assert word in said
