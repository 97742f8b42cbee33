"""Line coverage of a checkout, of one with three modules and one test."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from sdm.bench.suite.line_coverage import count, top_folder

pytest.importorskip("coverage")

MODULES = {
    "sdm/__init__.py": "",
    "sdm/called.py": (
        "import subprocess\nimport sys\n\n\n"
        "def run():\n    subprocess.run([sys.executable, '-m', 'sdm.child'], check=True)\n"
    ),
    "sdm/child.py": "print(1)\n",
    "kernels/__init__.py": "",
    "kernels/device.py": "class wp:\n    func = staticmethod(lambda f: f)\n\n\n@wp.func\ndef body():\n    return 1\n",
    "bench/__init__.py": "",
    "bench/unused.py": "x = 1\ny = 2\n",
    "tests/test_called.py": "import kernels.device\nfrom sdm.called import run\n\n\ndef test_it():\n    run()\n",
}


def test_a_small_checkout(tmp_path):
    tree, out = tmp_path / "tree", tmp_path / "out.json"
    for name, text in MODULES.items():
        path = tree / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    git = ["git", "-C", str(tree), "-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", "init", "-q", str(tree)], check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "first"], check=True)
    out.write_text(json.dumps({"older": {}}))
    command = [sys.executable, "-m", "sdm.bench.suite.line_coverage", "--tree", str(tree), "--out", str(out)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    older, record = json.loads(out.read_text()).values()
    assert older == {}
    assert record["pytest_status"] == 0, run.stdout
    # The child process counts, and what Warp would compile does not.
    assert record["sdm"] == {"statements": 5, "ran": 5, "percent": 100.0}
    assert record["kernels"] == {"statements": 2, "ran": 2, "percent": 100.0}
    assert record["bench"] == {"statements": 2, "ran": 0, "percent": 0.0}
    assert record["all"]["percent"] == pytest.approx(100 * 7 / 9, abs=0.01)


def test_links_count_as_what_they_name():
    summary = {"num_statements": 4, "covered_lines": 3}
    found = count({"sdm/kernels/a.py": {"summary": summary}, "sdm/engine/api.py": {"summary": summary}})
    assert (found["kernels"]["ran"], found["sdm"]["ran"], found["bench"]["ran"], found["all"]["ran"]) == (3, 3, 0, 6)
    assert [top_folder(name) for name in ("bench/x.py", "sdm/bench/x.py", "sdm/errors.py")] == ["bench", "bench", "sdm"]
