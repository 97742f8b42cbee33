"""Blocks of the documentation's pages: Python and commands run; what cannot run here is compiled or parsed."""

from __future__ import annotations

import importlib.util
import itertools
import re
import shlex

from tests.helpers.pages import blocks, put_demo_mesh

# Those that tests/unit/test_docs.py runs are not run twice.
ELSEWHERE = {"guide.md", "install.md", "speed.md", "from-disk-to-disk.md", "other-tools.md"}


def pages(root):
    return [path for path in sorted((root / "docs").rglob("*.md")) if path.name not in ELSEWHERE]


def run(words: list[str], capsys) -> None:
    from sdm.cli import main

    code = main(words)
    assert code == 0, f"sdm {shlex.join(words)}\n{capsys.readouterr().err}"
    capsys.readouterr()


def parse(line: str) -> None:
    """Check a command that is not run: the arguments of sdm, the modules of Python."""
    from sdm.cli.app import _parse

    words = list(itertools.takewhile(lambda word: word not in (">", "|"), shlex.split(line)))
    if words[0] == "sdm":
        assert callable(_parse(words[1:])), line
    if module := re.search(r"-m (sdm[\w.]*)", line):
        assert importlib.util.find_spec(module[1]) is not None, line
    assert words[0] in ("sdm", "make", "pip", "python", "torchrun", ".", "mkdir", "export", "git"), line


def pytest_generate_tests(metafunc):
    if "page" in metafunc.fixturenames:
        from pathlib import Path

        root = Path(__file__).parents[2]
        found = pages(root)
        metafunc.parametrize("page", found, ids=[str(path.relative_to(root)) for path in found])


def test_blocks_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    put_demo_mesh(tmp_path)
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for number, block in enumerate(blocks(page), 1):
        if block.language in ("python", "py"):
            code = compile(block.text, f"{page.name}, block {number}", "exec")
            if block.reason is None:
                exec(code, namespace)
        for line in block.commands() if block.language == "sh" else ():
            if block.reason is None:
                assert line.startswith("sdm "), f"{page.name}: mark the block of {line!r} as not run"
                run(shlex.split(line)[1:], capsys)
            else:
                parse(line)


# Pages beside the code: which test runs their Python. Their commands are parsed.
RUN_BY = {
    "README.md": "tests/unit/test_docs.py",
    "sdm/deepsdf/README.md": "tests/unit/deepsdf/test_readme.py",
    "sdm/fit/README.md": "tests/unit/fit/test_readme.py",
    "sdm/segmentation/README.md": "tests/unit/segmentation/test_readme.py",
    "sdm/shapes/README.md": "tests/unit/shapes/test_family.py",
    "sdm/stream/README.md": "tests/unit/stream/test_readme.py",
    "bench/README.md": "tests/unit/bench/common/test_own.py",
}


def pages_elsewhere(root):
    beside_code = [path for top in ("sdm", "bench") for path in (root / top).rglob("*.md")]
    return [*root.glob("*.md"), *(root / "docs" / name for name in sorted(ELSEWHERE)), *beside_code]


def test_python_of_other_pages_has_its_test(root):
    found = {
        name
        for page in pages_elsewhere(root)
        if any(block.language == "python" and block.reason is None for block in blocks(page))
        and (name := str(page.relative_to(root))).split("/")[-1] not in ELSEWHERE
    }
    assert found == set(RUN_BY)
    for page, test in RUN_BY.items():
        assert "README.md" in (root / test).read_text(), f"{test} runs {page} no more"


def test_commands_of_other_pages_parse(root):
    count = 0
    for page in pages_elsewhere(root):
        for block in blocks(page):
            for line in block.commands() if block.language == "sh" else ():
                parse(line)
                count += 1
    assert count > 40


def test_python_that_is_only_compiled_says_why(root):
    every = [*pages(root), *pages_elsewhere(root)]
    silent = [str(page) for page in every for block in blocks(page) if block.language == "py" and block.reason == "py"]
    assert not silent


def test_modules_that_pages_name_exist(root):
    named = {
        module.rstrip(".")
        for path in (root / "docs").rglob("*.md")
        for module in re.findall(r"python -m (sdm[\w.]*)", path.read_text())
    }
    assert len(named) > 5
    assert not [module for module in named if importlib.util.find_spec(module) is None]
