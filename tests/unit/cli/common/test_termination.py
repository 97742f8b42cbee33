"""Termination of a command: one line, and nothing half done is left."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest

from sdm.cli import app, main
from sdm.cli.common.termination import raised_termination

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")

WRITING = """
import os, signal, sys
from pathlib import Path
from sdm.cli import app
from sdm.io.files.atomic import replacing

def write():
    with replacing(Path(sys.argv[1])) as part:
        part.write_text("half")
        os.kill(os.getpid(), signal.SIGTERM)

app._parse = lambda words: write
sys.exit(app.main())
"""


def test_a_command_that_is_terminated(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WRITING, tmp_path / "map.npz"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (143, "sdm: terminated\n")
    assert not list(tmp_path.iterdir())


def test_a_library_may_make_an_interrupt_of_it(monkeypatch, capsys):
    """Ray's native calls, in which the signal comes, raise a plain `KeyboardInterrupt`."""

    def wait() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_parse", lambda words: wait)
    assert main(["x"]) == 143
    assert capsys.readouterr().err == "sdm: terminated\n"


def test_the_signal_is_what_it_was_afterwards(monkeypatch):
    seen = []
    monkeypatch.setattr(app, "_parse", lambda words: lambda: seen.append(signal.getsignal(signal.SIGTERM)))
    assert main(["x"]) == 0
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    assert callable(seen[0])
    # What is ignored stays so, and other threads may not ask.
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        assert main(["x"]) == 0
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen[1] == signal.SIG_IGN
    other = threading.Thread(target=main, args=(["x"],))
    other.start()
    other.join()
    assert seen[2] == signal.SIG_DFL


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_fork_ends_at_once():
    with raised_termination():
        child = os.fork()
        if child == 0:
            os.kill(os.getpid(), signal.SIGTERM)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 143
