"""Ages of the records in `bench/results`: how often the kernels have changed since.

    python -m sdm.bench.suite.record_ages

One line for each commit that a record names, oldest first. A + is a tree with changes that were not committed; a commit
that was rebased, or of a branch that was never merged, is not in the history.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "bench" / "results"
STAMP = re.compile(r'"commit"\s*:\s*"([0-9a-f]{7,40}\+?)')


def commits_of(text: str) -> list[str]:
    """Commits that a record names, each once."""
    return list(dict.fromkeys(STAMP.findall(text)))


def changes_since(commit: str, folder: str = "kernels") -> int | None:
    """Number of commits that change a folder since; None where the commit is not in the history."""
    command = ["git", "rev-list", "--count", f"{commit.rstrip('+')}..HEAD", "--", folder]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return int(found.stdout) if found.returncode == 0 else None


def main() -> None:
    """Print the table."""
    rows: list[tuple[str, str, int | None]] = []
    for path in sorted(RESULTS.glob("*.json*")):
        commits = commits_of(path.read_text())
        rows += [(path.name, commit, changes_since(commit)) for commit in commits] or [(path.name, "none named", None)]
    rows.sort(key=lambda row: -1 if row[2] is None else row[2], reverse=True)
    for name, commit, count in rows:
        told = "not in the history" if count is None else f"{count} changes of kernels since"
        print(f"{name:<36} {commit:<14} {told}")


if __name__ == "__main__":
    main()
