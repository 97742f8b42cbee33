"""Kill -9 of a command in the middle of its work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

CHILD = "import sys; from sdm.cli import main; sys.exit(main())"


def killed_after(words: Sequence[str], folder: Path, pattern: str, count: int = 3) -> None:
    """Run `sdm` with these words in a process of its own, and kill it once so many files of a folder are there."""
    child = subprocess.Popen([sys.executable, "-W", "ignore", "-c", CHILD, *words], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 90
    while len(list(folder.glob(pattern))) < count:
        assert time.monotonic() < deadline
        assert child.poll() is None
        time.sleep(0.005)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
