"""House rules of the source tree: sizes of files and folders, names of modules, first lines of docstrings."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path

import pytest

MOST_LINES, MOST_MODULES = 400, 18
LOOSE_MODULES = {"sdm": 4, "kernels": 3}
TOPS = ("sdm", "kernels", "bench", "tests")
# Words that announce a thing without naming it.
FIRST_WORDS = re.compile(r"(What|Which|Where|How|Whether)\b")
# Names without a meaning outside this project, or with several, and the field's.
METAPHORS = {
    "shelf": "graph_cache", "board": "lane_broadcast", "placing": "output_slot", "beside": "prefetch",
    "ahead": "prefetch", "places": "graph_cache", "rows": "the kind of row", "lists": "the kind of list",
    "nasty": "degenerate",
}  # fmt: skip
# Sizes of boxes of voxels, each of which the glossary has to name.
BOXES = {"grid", "slab", "region", "cell", "brick", "block", "octant", "eighth", "tile", "band"}
MOST_GLOSSARY_LINES = 40


def modules(root: Path, *tops: str) -> list[Path]:
    """Python files, by their paths in the checkout; the links sdm/kernels and sdm/bench are not followed."""
    found = []
    for top in tops:
        for path in (root / top).rglob("*.py"):
            place = path.relative_to(root)
            if place.parts[:2] not in (("sdm", "kernels"), ("sdm", "bench")):
                found.append(place)
    return sorted(found)


def nodes(path: Path) -> list[ast.AST]:
    """A file's syntax tree without its expressions, which are most of it and hold no definitions."""
    found: list[ast.AST] = [ast.parse(path.read_text())]
    for node in found:
        found += [part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr)]
    return found


def test_files_are_short(root):
    long = {str(path): count for path in modules(root, *TOPS) if (count := lines(root / path)) > MOST_LINES}
    assert not long


def lines(path: Path) -> int:
    return len(path.read_text().splitlines())


def test_folders_hold_few_modules(root):
    count: dict[Path, int] = defaultdict(int)
    for path in modules(root, *TOPS):
        count[path.parent] += path.name != "__init__.py"
    assert not {str(folder): number for folder, number in count.items() if number > MOST_MODULES}


@pytest.mark.parametrize("top", LOOSE_MODULES)
def test_few_modules_lie_loose(root, top):
    loose = [path.name for path in (root / top).glob("*.py") if not path.name.startswith("__")]
    assert len(loose) <= LOOSE_MODULES[top]


def test_modules_of_bench_are_not_private(root):
    assert not [str(path) for path in modules(root, "bench") if re.match(r"_[a-z]", path.name)]


def test_names_of_modules_are_told_apart(root):
    named: dict[str, list[Path]] = defaultdict(list)
    for path in modules(root, "sdm", "kernels"):
        if not path.name.startswith("__"):
            named[path.stem].append(path.parent)
    twins = {
        name: [str(folder) for folder in folders]
        for name, folders in named.items()
        if not all(is_plain(*pair) for pair in combinations(folders, 2))
    }
    assert not twins


def test_names_of_modules_are_the_fields(root):
    named = {str(path): METAPHORS[path.stem] for path in modules(root, *TOPS) if path.stem in METAPHORS}
    assert not named


def test_names_of_parameters_are_the_fields(root):
    found = []
    for path in modules(root, "sdm"):
        for node in nodes(root / path):
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                names = [each.arg for each in (*node.args.args, *node.args.kwonlyargs)]
                found += [f"{path}: {node.name}({name})" for name in names if name in {"shelf", "board", "ahead"}]
    assert not found


def test_glossary_is_short_and_has_each_term_once(root):
    text = (root / "ARCHITECTURE.md").read_text()
    glossary = text[text.index("## Glossary") : text.index("## Rules that hold everywhere")]
    assert len(glossary.splitlines()) <= MOST_GLOSSARY_LINES
    terms = re.findall(r"\*\*([\w ]+)\*\*", glossary + (root / "docs" / "glossary.md").read_text())
    assert len(terms) > 50
    assert not {term for term in terms if terms.count(term) > 1}
    assert set(terms) >= BOXES


def is_plain(one: Path, other: Path) -> bool:
    """True if two folders may have modules of one name: commands, kernels of a host module, and parallel packages."""
    command = Path("sdm/cli/commands") in (one, other)
    kernel = one.parts[0] != other.parts[0] and one.parts[1:] == other.parts[1:]
    parallel = one.name == other.name or one.parent == other.parent
    return command or kernel or parallel


def test_unit_tests_mirror_the_tree(root):
    folders = {path.parent.relative_to("tests/unit") for path in modules(root, "tests/unit")}
    assert not [str(folder) for folder in folders if not (root / "sdm" / folder).is_dir()]


def test_docstrings_name_the_thing(root):
    found = []
    for path in modules(root, *TOPS):
        for node in nodes(root / path):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                first = (ast.get_docstring(node, clean=False) or "").strip().split("\n")[0]
                if FIRST_WORDS.match(first):
                    found.append(f"{path}: {first}")
    assert not found
