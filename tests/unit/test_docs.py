from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest

from tests.helpers.pages import put_demo_mesh

PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/other-tools.md")
GUIDES = ("docs/guide.md", "docs/install.md", "docs/speed.md", "docs/from-disk-to-disk.md")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def samples(page: Path, language: str) -> list[str]:
    return [code for kind, code in FENCE.findall(page.read_text()) if kind == language]


@pytest.fixture
def place_with_demo_mesh(tmp_path, monkeypatch) -> Path:
    put_demo_mesh(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", [*PAGES, *GUIDES])
def test_python_samples_run(name, root, place_with_demo_mesh):
    """The samples of a page run one after the other, as a reader would type them."""
    code = samples(root / name, "python")
    assert code or name not in ("README.md", "docs/guide.md")
    namespace: dict[str, object] = {}
    for number, text in enumerate(code):
        exec(compile(text, f"{name}, sample {number + 1}", "exec"), namespace)


def commands(page: Path) -> list[str]:
    lines = "".join(samples(page, "sh")).splitlines()
    return [line.split(" #")[0].strip() for line in lines if line.startswith("sdm ")]


def test_commands_run(root, place_with_demo_mesh, capsys):
    """Those of two pages, of which each makes files of its own; what both have runs once."""
    from sdm.cli import main

    pages = [commands(root / name) for name in ("README.md", "docs/guide.md")]
    assert min(map(len, pages)) >= 3
    for line in dict.fromkeys(pages[0] + pages[1]):
        code = main(shlex.split(line)[1:])
        assert code == 0, f"{line}\n{capsys.readouterr().err}"
    assert (place_with_demo_mesh / "cochlea.nii.gz").stat().st_size > 1000


def make_targets(root: Path) -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (root / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("name", [*PAGES, *GUIDES])
def test_make_targets_exist(name, root):
    text = (root / name).read_text()
    named = set(re.findall(r"`make ([a-z-]+)", text))
    named |= set(re.findall(r"^make ([a-z-]+)", "".join(samples(root / name, "sh")), re.MULTILINE))
    assert named <= make_targets(root)


@pytest.mark.parametrize("name", PAGES)
def test_links_and_named_files_exist(name, root):
    text = (root / name).read_text()
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", text):
        assert (root / target).exists(), target
    for target in re.findall(r"`((?:sdm|kernels|tests|bench)/[\w/.]*)`", text):
        assert (root / target).exists(), target


def test_every_extra_is_named(root):
    import tomllib

    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    text = (root / "docs/install.md").read_text().split("## Extras")[1].split("\n## ")[0]
    assert set(re.findall(r"^\| `([a-z-]+)` \|", text, re.MULTILINE)) == set(extras)


def test_pages_name_no_place_of_one_machine(root):
    files = [root / name for name in (*PAGES, *GUIDES, "Makefile", "constraints.txt", "pyproject.toml", ".ci/run")]
    for path in files:
        assert not re.search(r"/(?:home|root|work|Users|opt)/", path.read_text()), path.name


def test_version_of_python_is_said_alike(root):
    wanted = re.search(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', (root / "pyproject.toml").read_text())
    assert wanted is not None
    low, high = int(wanted[1]), int(wanted[2]) - 1
    assert f"Python 3.{low} to 3.{high}" in (root / "README.md").read_text()
    assert f"(3, {low}) <= sys.version_info[:2] <= (3, {high})" in (root / "Makefile").read_text()
    assert (3, low) <= sys.version_info[:2] <= (3, high)
    assert os.access(root / ".ci" / "run", os.X_OK)


def test_links_of_all_pages_exist(root):
    pages = [path for top in ("sdm", "bench", "docs") for path in (root / top).rglob("*.md")]
    missing = {}
    for page in pages:
        targets = re.findall(r"\]\((?!https?:)([^)#\s]+)\)", page.read_text())
        if lost := [target for target in targets if not (page.parent / target).exists()]:
            missing[str(page.relative_to(root))] = lost
    assert len(pages) > 20
    assert not missing


def test_outside_links_are_well_formed(root):
    """That they answer is not asked, as tests need no network."""
    for page in root.rglob("*.md"):
        if ".venv" not in page.parts and "build" not in page.parts:
            for address in re.findall(r"\]\((\w+://[^)\s]*)", page.read_text()):
                assert re.fullmatch(r"https://(\w[\w-]*\.)+[a-z]{2,}(:\d+)?(/[\w./%~-]*)?(#[\w-]+)?", address), page


def test_decisions_named_in_code_exist(root):
    named = {
        name
        for top in ("sdm", "kernels", "bench")
        for path in (root / top).rglob("*.py")
        for name in re.findall(r"bench/decisions/[\w.-]+", path.read_text())
    }
    assert named
    assert not [name for name in named if not (root / name.rstrip(".")).exists()]
    index = (root / "bench/decisions/README.md").read_text()
    assert not [path.name for path in (root / "bench/decisions").glob("0*.md") if f"({path.name})" not in index]
