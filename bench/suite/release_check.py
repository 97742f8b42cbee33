"""Checks of built distributions, each in an environment of its own that has no compiler to hand.

    python -m sdm.bench.suite.release_check dist [-- pip's options]

Of the wheel: it installs with its dependencies from wheels alone; the commands of README.md run where nothing else is,
`sdm demo` first, which the others read; so do the shipped networks (`sdm predict`, `sdm encode`) and `sdm bench`; the
package is typed, and takes nothing from the checkout. Of the sdist: its wheel has the same files. Pip's options are
for example an index of PyTorch's CPU builds. Nothing is uploaded.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

CONSTRAINTS = "constraints.txt"
FENCE = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# What README.md does not type: the networks that come along, the benchmark, and how the package is typed.
MORE = (
    "sdm predict --a 4.0 --alpha 0.2 --b 0.15 --phi 0.1 -o predicted.nii.gz",
    "sdm encode demo/demo.ply --model cochlea -o code.npz --steps 10",
    "sdm bench --quick --device cpu --meshes torus-500 --resolutions 8 --peers sdm --out compared",
    "python -c 'import sdm.kernels, sdm.bench, os; assert os.path.isfile(os.path.join(sdm.__path__[0], \"py.typed\"))'",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dist", type=Path)
    parser.add_argument("pip", nargs="*", help="options of `pip install`")
    options = parser.parse_args()
    (wheel,), (source,) = options.dist.glob("*.whl"), options.dist.glob("*.tar.gz")
    root = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        check_sdist(source, wheel, work)
        bin_folder = fresh(work / "venv")
        words = [*options.pip, "--only-binary", ":all:", "-c", str(root / CONSTRAINTS), str(wheel.resolve())]
        # Elsewhere than in the checkout, which would count as installed.
        install = [bin_folder / "python", "-m", "pip", "install", "-q", *words]
        subprocess.run(install, check=True, cwd=work, env=plain_environment())
        place = work / "place"
        place.mkdir()
        for line in [*readme_commands(root / "README.md"), *MORE]:
            run(line, bin_folder, place)
    print(f"{wheel.name} and {source.name} are ready; nothing was uploaded")


def readme_commands(page: Path) -> list[str]:
    """The page's `sdm` commands, the one that makes what the others read first."""
    lines = [line.split(" #")[0].strip() for text in FENCE.findall(page.read_text()) for line in text.splitlines()]
    found = [line for line in lines if line.startswith("sdm ")]
    return sorted(found, key=lambda line: not line.startswith("sdm demo"))


def check_sdist(source: Path, wheel: Path, work: Path) -> None:
    """Compare the wheel that is made of the sdist with the other one."""
    built = work / "from-sdist"
    subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", built, source.resolve()], check=True)
    (again,) = built.glob("*.whl")
    first, second = (set(zipfile.ZipFile(file).namelist()) for file in (wheel, again))
    if first != second:
        raise SystemExit(f"the sdist's wheel differs from the wheel: {sorted(first ^ second)[:5]}")


def fresh(folder: Path) -> Path:
    """The programs' folder of a new environment with pip alone."""
    venv.create(folder, with_pip=True)
    return folder / ("Scripts" if os.name == "nt" else "bin")


def plain_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def run(line: str, bin_folder: Path, place: Path) -> None:
    """A command by the environment's programs, in an otherwise empty folder; a compiler would be /bin/false."""
    print(line, flush=True)
    path = os.pathsep.join([str(bin_folder), os.environ["PATH"]])
    words = shlex.split(line)
    program = bin_folder / words[0]
    settings = {**plain_environment(), "PATH": path, "CC": "/bin/false", "CXX": "/bin/false"}
    done = subprocess.run([program, *words[1:]], cwd=place, env=settings, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{line}\nends with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


if __name__ == "__main__":
    main()
