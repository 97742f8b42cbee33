"""The page's sample runs, and the options it shows are there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest


def test_the_sample_runs(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(
        r"^```python\n(.*?)^```$", (root / "sdm" / "deepsdf" / "README.md").read_text(), re.MULTILINE | re.DOTALL
    )
    names: dict[str, object] = {}
    exec(compile(code, "sdm/deepsdf/README.md", "exec"), names)
    assert (tmp_path / "model" / "model.pt").exists()


def test_the_options_of_the_page_are_there(root: Path) -> None:
    page = (root / "sdm" / "deepsdf" / "README.md").read_text()
    (block,) = re.findall(r"^```sh\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    shown: dict[str, set[str]] = {}
    for line in block.splitlines():
        words = line.split("#")[0].split()
        command = " ".join(words[1:3]) if words[1] == "train" else words[1]
        shown.setdefault(command, set()).update(word for word in words if word.startswith("--"))
    assert set(shown) == {"train deepsdf", "encode", "decode"}
    for command, options in shown.items():
        said = subprocess.run(
            [sys.executable, "-m", "sdm", *command.split(), "--help"], capture_output=True, text=True, check=True
        ).stdout
        assert options <= set(re.findall(r"--[a-z-]+", said)), command
