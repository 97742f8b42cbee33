from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from dataclasses import dataclass
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


@pytest.fixture(scope="module")
def source(root, tmp_path_factory) -> Path:
    """The files that a wheel is built from, without what builds leave behind."""
    folder = tmp_path_factory.mktemp("source")
    for name in ("sdm", "kernels", "bench"):
        shutil.copytree(root / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "-w", str(folder), str(source)], check=True)
    (built,) = folder.glob("*.whl")
    return built


@dataclass(frozen=True)
class Installed:
    """An environment with the wheel alone, its site-packages, and the libraries that it borrows from this one."""

    folder: Path
    site: Path
    libraries: Path

    def run(self, program: str, *words: str, cwd: Path) -> str:
        # This project's editable copy is not borrowed: a .pth file is read from site folders alone.
        borrowed = {**os.environ, "PYTHONPATH": str(self.libraries)}
        return subprocess.check_output([self.folder / "bin" / program, *words], cwd=cwd, text=True, env=borrowed)

    def files(self) -> set[Path]:
        return {path for path in self.site.rglob("*") if path.is_file() and path.suffix != ".pyc"}


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Installed:
    folder = tmp_path_factory.mktemp("installed") / "venv"
    venv.create(folder, system_site_packages=False, symlinks=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(pip, check=True)
    where = subprocess.check_output([python, "-c", "import site; print(site.getsitepackages()[0])"], text=True)
    return Installed(folder, Path(where.strip()), Path(pytest.__file__).parents[1])


@pytest.mark.slow
def test_the_wheel_holds_every_module_and_no_results(root, wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    for top, prefix in (("sdm", ""), ("kernels", "sdm/"), ("bench", "sdm/")):
        modules = {prefix + path.relative_to(root).as_posix() for path in (root / top).rglob("*.py")}
        assert modules <= names
    assert {name for name in names if name.startswith("sdm/bench/") and not name.endswith(".py")} == set()
    assert {name.split("/")[0] for name in names} == {"sdm", wheel.name.rsplit("-", 3)[0] + ".dist-info"}


@pytest.mark.slow
def test_an_installed_copy_works_from_inside_the_checkout(source, installed, tmp_path):
    """The wheel holds every module, and ./sdm, which hides it there, finds the kernels too."""
    program = "import sdm, sdm.kernels, sdm.bench; print(sdm.__file__)"
    for folder, expected in ((tmp_path, installed.site), (source, source)):
        found = installed.run("python", "-W", "ignore", "-c", program, cwd=folder)
        assert found.strip().splitlines()[-1].startswith(str(expected))


@pytest.mark.slow
def test_the_benchmark_of_an_installed_copy_writes_to_the_current_folder_alone(installed, tmp_path):
    before = installed.files()
    small = ["--quick", "--device", "cpu", "--meshes", "torus-500", "--resolutions", "8", "--peers", "sdm"]
    said = installed.run("sdm", "bench", *small, "--out", "compared", cwd=tmp_path)
    assert "torus-500 at 8^3" in said
    assert {path.name for path in tmp_path.iterdir()} == {"compared"}
    assert {"results.json", "report.md"} <= {path.name for path in (tmp_path / "compared").iterdir()}
    program = "from sdm.bench.common.checkout import results_folder; print(results_folder().resolve())"
    assert installed.run("python", "-c", program, cwd=tmp_path).strip() == str(tmp_path)
    assert installed.files() == before


@pytest.mark.slow
def test_an_editable_copy_is_a_path_which_type_checkers_follow(source, tmp_path):
    program = f"import setuptools.build_meta as b; print(b.build_editable({str(tmp_path)!r}))"
    subprocess.run([sys.executable, "-c", program], cwd=source, check=True, capture_output=True)
    (built,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        (link,) = [name for name in archive.namelist() if name.endswith(".pth")]
        assert Path(archive.read(link).decode().strip()).resolve() == source.resolve()


def plain(name: str) -> str:
    return re.sub("[-_.]+", "-", name).lower()
