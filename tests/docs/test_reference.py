"""The reference has every public name and every command."""

from __future__ import annotations

import importlib.util
import re

import sdm
from sdm.cli.app import COMMANDS
from sdm.cli.common.examples import EXAMPLES

ADAPTERS = {"monai", "torchio", "nnunet", "jax", "pyvista"}


def reference(root) -> str:
    return "\n".join(path.read_text() for path in (root / "docs" / "reference").glob("*.md"))


def test_every_name_of_the_library_has_a_place(root):
    listed = re.findall(r"public-names:: sdm\n   :only: (.*)", reference(root))
    names = " ".join(listed).split()
    assert sorted(names) == sorted(sdm.__all__)


def test_every_package_has_a_page(root):
    packages = set(re.findall(r"public-names:: sdm\.([\w.]+)", reference(root)))
    told = {package for package in sdm._PACKAGES if package not in ("compat", "cuda_graphs")}
    assert told | ADAPTERS <= packages
    drop_ins = {path.stem for path in (root / "sdm" / "compat").glob("*.py")} - {"__init__", "closest_in_float64"}
    assert {f"compat.{name}" for name in drop_ins} <= packages
    assert all(importlib.util.find_spec(f"sdm.{package}") for package in packages)


def test_every_command_has_its_help(root):
    told = set(re.findall(r"command-help:: (.*)", reference(root)))
    assert set(EXAMPLES) <= told
    assert {name.split()[0] for name in told} == set(COMMANDS)


def test_pages_of_the_site_are_in_its_table(root):
    index = (root / "docs" / "index.md").read_text()
    told = {
        line.strip() for block in re.findall(r"```{toctree}(.*?)```", index, re.DOTALL) for line in block.splitlines()
    }
    pages = {str(path.relative_to(root / "docs").with_suffix("")) for path in (root / "docs").rglob("*.md")}
    assert pages - {"index"} <= told
