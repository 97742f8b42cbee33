from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest


def project(root: Path) -> dict:
    return tomllib.loads((root / "pyproject.toml").read_text())


def test_every_folder_with_code_is_a_package(root):
    """A folder without __init__.py works from the checkout and is missing from an installed copy."""
    for top in ("sdm", "kernels", "bench"):
        folders = {path.parent for path in (root / top).rglob("*.py")}
        assert not [folder for folder in folders if not (folder / "__init__.py").is_file()]


@pytest.mark.parametrize("name", ["kernels", "bench"])
def test_folders_beside_the_package_are_found_in_a_checkout(root, name):
    assert (root / "sdm" / name).resolve() == (root / name).resolve()


def test_every_dependency_is_pinned_within_its_range(root):
    from packaging.requirements import Requirement

    lines = (root / "constraints.txt").read_text().splitlines()
    pins = {}
    for line in lines:
        if line and not line.startswith("#"):
            name, version = line.split("==")
            pins[plain(name)] = version
    wanted = list(project(root)["project"]["dependencies"])
    for extra in project(root)["project"]["optional-dependencies"].values():
        wanted += extra
    for text in wanted:
        requirement = Requirement(text)
        assert requirement.specifier.contains(pins[plain(requirement.name)]), text


def test_the_version_is_said_once(root):
    import sdm

    assert project(root)["project"]["version"] == sdm.__version__
    assert f"[{sdm.__version__}]" in (root / "CHANGELOG.md").read_text()


@pytest.mark.slow
def test_an_installed_copy_works_from_inside_the_checkout(root, tmp_path):
    """The wheel holds every module, and ./sdm, which hides it there, finds the kernels too."""
    source = tmp_path / "source"
    source.mkdir()
    for name in ("sdm", "kernels", "bench"):
        shutil.copytree(root / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / name, source / name)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "-w", str(tmp_path), str(source)], check=True)
    (wheel,) = tmp_path.glob("*.whl")

    place = tmp_path / "venv"
    venv.create(place, system_site_packages=False, symlinks=True)
    python = place / "bin" / "python"
    where = subprocess.check_output([python, "-c", "import site; print(site.getsitepackages()[0])"], text=True)
    site = Path(where.strip())
    # The libraries are borrowed, this project's editable copy is not: a .pth file is read from site folders alone.
    libraries = Path(pytest.__file__).parents[1]
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(pip, check=True)
    program = (
        f"import sys; sys.path.append({str(libraries)!r}); import sdm, sdm.kernels, sdm.bench; print(sdm.__file__)"
    )
    for folder, expected in ((tmp_path, site), (source, source)):
        found = subprocess.check_output([python, "-W", "ignore", "-c", program], cwd=folder, text=True)
        assert found.strip().splitlines()[-1].startswith(str(expected))


def plain(name: str) -> str:
    return re.sub("[-_.]+", "-", name).lower()
