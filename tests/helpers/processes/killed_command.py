"""Kill -9 of a command in the middle of its work."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path

from sdm.cli import main
from tests.helpers.processes.forked import Forked

CHILD = "import sys; from sdm.cli import main; sys.exit(main())"


def killed_after(words: Sequence[str], folder: Path, pattern: str, count: int = 3) -> None:
    """Run `sdm` with these words in a process of its own, and kill it once so many files of a folder are there."""
    child = Forked(lambda: main(words))
    child.wait_for(lambda: len(list(folder.glob(pattern))) >= count)
    os.kill(child.pid, signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
