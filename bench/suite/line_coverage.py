"""Line coverage of a checkout's tests: statements that ran, by top folder.

    python -m sdm.bench.suite.line_coverage [--tree PATH] [--out FILE.json] [-- pytest's arguments]

The quick tests run once under coverage.py, with the processes that they start. A body that Warp compiles (decorated
with `wp.kernel`, `wp.func` or `wp.func_native`) never runs as Python and is left out, as is what only type checkers
read.
`--tree` is another checkout, measured in the same way with this environment. `--out` adds to the records that the file
has of other commits.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import write

TOPS = ("kernels", "sdm", "bench")
SETTINGS = """[run]
source = {sources}
omit = */tests/*
data_file = {work}/data
parallel = true
concurrency = thread,multiprocessing
sigterm = true
disable_warnings = no-data-collected,module-not-imported,module-not-measured,module-not-python,couldnt-parse
[report]
ignore_errors = true
exclude_also =
    @wp\\.(kernel|func)
    if TYPE_CHECKING:
    if typing.TYPE_CHECKING:
[json]
output = {work}/report.json
"""


def measure(tree: Path, arguments: list[str]) -> dict[str, Any]:
    """Run the tests of a checkout and count: statements, those that ran, and percent, in all and by top folder."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        settings = work / "settings.ini"
        settings.write_text(SETTINGS.format(sources=",".join(str(tree / top) for top in TOPS), work=work))
        # Python imports `sitecustomize` as it starts: so are processes measured that tests start.
        (work / "sitecustomize.py").write_text("import coverage\n\ncoverage.process_startup()\n")
        environment = {
            **os.environ,
            "COVERAGE_PROCESS_START": str(settings),
            "PYTHONPATH": os.pathsep.join([str(work), str(tree), *filter(None, [os.environ.get("PYTHONPATH")])]),
        }
        words = ["-m", "pytest", "-m", "not slow", "-n", "0", "-q", "-p", "no:cacheprovider", *arguments]
        status = subprocess.run([sys.executable, *words], cwd=tree, env=environment, check=False).returncode
        tool = [sys.executable, "-m", "coverage"]
        subprocess.run([*tool, "combine", "-q", f"--rcfile={settings}"], cwd=tree, check=True)
        subprocess.run([*tool, "json", "-q", f"--rcfile={settings}"], cwd=tree, check=True)
        files = json.loads((work / "report.json").read_text())["files"]
    return {"pytest_status": status, **count(files)}


def count(files: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Statements by top folder, from coverage.py's report by file; the links into sdm count as what they name."""
    totals = {top: [0, 0] for top in (*TOPS, "all")}
    for name, found in files.items():
        summary = found["summary"]
        for top in (top_folder(name), "all"):
            totals[top][0] += summary["num_statements"]
            totals[top][1] += summary["covered_lines"]
    return {
        top: {"statements": total, "ran": ran, "percent": round(100 * ran / max(total, 1), 2)}
        for top, (total, ran) in totals.items()
    }


def top_folder(name: str) -> str:
    """The folder of `TOPS` that a file belongs to, by its path in the checkout."""
    parts = Path(name).parts
    return parts[1] if parts[0] == "sdm" and parts[1] in TOPS else parts[0]


def commit(tree: Path) -> str:
    """Short hash of the checkout's commit."""
    words = ["git", "-C", str(tree), "rev-parse", "--short=12", "HEAD"]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def main() -> int:
    """As the module says."""
    parser = argparse.ArgumentParser("python -m sdm.bench.suite.line_coverage", description=__doc__)
    parser.add_argument("--tree", type=Path, default=Path(), help="checkout (default: the current folder)")
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument("arguments", nargs="*", help="arguments for pytest, after --")
    options = parser.parse_args()
    tree = options.tree.resolve()
    if not (tree / "sdm").is_dir() or not (tree / "tests").is_dir():
        print(f"{tree} is no checkout of sdm: name its folder with --tree", file=sys.stderr)
        return 2
    record = measure(tree, options.arguments)
    for top in (*TOPS, "all"):
        found = record[top]
        print(f"{top:8} {found['ran']:7} of {found['statements']:7} statements  {found['percent']:6.2f} %")
    if options.out is not None:
        records = json.loads(options.out.read_text()) if options.out.exists() else {}
        write(options.out, {**records, commit(tree): record})
    return 0


if __name__ == "__main__":
    sys.exit(main())
