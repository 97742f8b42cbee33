"""A copy of the tests' process that runs something and may be killed: all that it needs is imported already.

For what is tested of the process's end, not of its start: a new interpreter takes seconds to import torch and Warp.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path


class Forked:
    """`work` in a process of its own, which ends with the number that it gives; output goes to the file `said`."""

    def __init__(self, work: Callable[[], int | None], said: Path = Path(os.devnull)) -> None:
        self.code: int | None = None
        with warnings.catch_warnings():
            # The threads of this process are not there in the other, and it waits for none.
            warnings.filterwarnings("ignore", ".*fork", DeprecationWarning)
            self.pid = os.fork()
        if self.pid == 0:
            _end_with(work, said)

    def poll(self) -> int | None:
        """Its exit code, the signal below zero; None while it runs."""
        if self.code is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.code = os.waitstatus_to_exitcode(status) if ended else None
        return self.code

    def wait(self, seconds: float = 90.0) -> int:
        """Its exit code; a process that does not end in time is killed, and the test fails."""
        limit = time.monotonic() + seconds
        while (code := self.poll()) is None:
            if time.monotonic() > limit:
                os.kill(self.pid, signal.SIGKILL)
                raise TimeoutError(f"process {self.pid} did not end within {seconds:g} s")
            time.sleep(0.005)
        return code

    def wait_for(self, done: Callable[[], object], seconds: float = 90.0) -> None:
        """Wait until something is done by it, which fails if it ends before."""
        limit = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < limit
            assert self.poll() is None
            time.sleep(0.005)


def _end_with(work: Callable[[], int | None], said: Path) -> None:
    """Do the work, and end at once, whatever comes: tests go on in the other process alone."""
    code = 1
    try:
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT, 0o600), 1)
        os.dup2(1, 2)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
        # A shell that runs tests in the background makes its children ignore interrupts.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        warnings.simplefilter("ignore")
        import torch

        # Torch's own threads do not survive a fork.
        torch.set_num_threads(1)
        code = work() or 0
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
