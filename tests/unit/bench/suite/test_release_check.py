"""The check of a release: what it runs, and that it stops where a command fails."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest

from sdm.bench.suite import release_check


def test_commands_of_the_readme(root):
    found = release_check.readme_commands(root / "README.md")
    assert found[0].startswith("sdm demo")
    assert any(line.startswith("sdm compute") for line in found)
    assert all(line.startswith("sdm ") for line in found)


def test_a_failure_stops_it(tmp_path):
    here = Path(sys.executable).parent
    release_check.run("python -c 'print(1)'", here, tmp_path)
    with pytest.raises(SystemExit, match="ends with 3"):
        release_check.run("python -c 'raise SystemExit(3)'", here, tmp_path)


def test_an_sdist_that_lacks_a_file_is_found(tmp_path, monkeypatch):
    def build(words, check):
        with zipfile.ZipFile(tmp_path / "from-sdist" / "a.whl", "w") as archive:
            archive.writestr("a", "")

    (tmp_path / "from-sdist").mkdir()
    with zipfile.ZipFile(tmp_path / "b.whl", "w") as archive:
        archive.writestr("a", "")
        archive.writestr("b", "")
    monkeypatch.setattr(release_check.subprocess, "run", build)
    with pytest.raises(SystemExit, match="differs"):
        release_check.check_sdist(tmp_path / "a.tar.gz", tmp_path / "b.whl", tmp_path)
