"""Worker processes: calls, shared memory, errors, and that none of them outlives the process that started it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from sdm.errors import FormatError, SDMError
from sdm.runtime.worker_processes.pool import WorkerProcesses
from sdm.runtime.worker_processes.shared_memory import SharedMemory, can_share, packed

pytestmark = pytest.mark.skipif(not can_share(), reason="this system has no memory without a name")
HERE = "tests.unit.runtime.worker_processes.test_pool"
ROOT = Path(__file__).parents[4]


def sum_of(values: np.ndarray) -> tuple[int, bool]:
    return int(values.sum()), values.flags.writeable


def fails(error: Exception) -> None:
    raise error


def ends() -> None:
    os._exit(3)


def process(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def has(module: str) -> bool:
    return module in sys.modules


BOTH = threading.Barrier(2)


def meet() -> int:
    BOTH.wait(60)
    return os.getpid()


def unsayable() -> threading.Lock:
    return threading.Lock()


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


def test_each_sees_the_memory():
    with (
        closing(SharedMemory(1000)) as first,
        closing(SharedMemory(10_000)) as second,
        WorkerProcesses(f"{HERE}:sum_of", 2, shared=[first, second]) as workers,
    ):
        part = second.content[80:8080].view(np.float64).reshape(100, 10)
        for value in (1, 2):
            part[:] = value
            assert workers.call(part) == (1000 * value, False)
        assert workers.call(first.content) == (0, False)
        # What is elsewhere, or has gaps, is copied.
        assert workers.call(part[:, ::2]) == (1000, True)
        assert workers.call(np.ones(3)) == (3, True)


def test_of_shared_arrays_little_is_sent():
    with closing(SharedMemory(1_000_000)) as memory:
        assert len(packed((1, {"values": memory.content}), [memory])) < 1000
        assert len(packed((1, {"values": memory.content.copy()}), [memory])) > 1_000_000


def test_calls_of_several_threads_go_to_several_processes():
    with WorkerProcesses(f"{HERE}:process", 2) as workers, ThreadPoolExecutor(2) as threads:
        assert len(set(threads.map(workers.call, (0.3, 0.3)))) == 2


def test_a_process_does_several_calls_beside_each_other():
    with WorkerProcesses(f"{HERE}:meet", 1, calls=2) as workers, ThreadPoolExecutor(4) as threads:
        assert len({call.result() for call in [threads.submit(workers.call) for _ in range(4)]}) == 1


def test_calls_go_to_who_has_least_to_do():
    with WorkerProcesses(f"{HERE}:process", 2, calls=2) as workers, ThreadPoolExecutor(2) as threads:
        assert len(set(threads.map(workers.call, (0.3, 0.3)))) == 2


def test_an_answer_that_cannot_be_sent_is_not_waited_for():
    with WorkerProcesses(f"{HERE}:unsayable", 1) as workers, pytest.raises(SDMError, match="a worker process died"):
        workers.call()


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), FormatError("no map")], ids=str)
def test_an_error_is_raised_here_and_the_process_goes_on(error):
    with WorkerProcesses(f"{HERE}:fails", 1) as workers:
        for _ in range(2):
            with pytest.raises(type(error), match=str(error).replace("[", r"\[")) as raised:
                workers.call(error)
            assert getattr(raised.value, "errno", None) == getattr(error, "errno", None)


@pytest.mark.parametrize("imports", [[], ["colorsys", "sched"]])
def test_further_modules_are_imported_beforehand(imports):
    with WorkerProcesses(f"{HERE}:has", 1, imports=imports) as workers:
        assert [workers.call(name) for name in ("colorsys", "sched")] == [bool(imports)] * 2


def test_one_that_dies_is_said():
    with WorkerProcesses(f"{HERE}:ends", 1) as workers:
        for _ in range(2):
            with pytest.raises(SDMError, match=r"a worker process died \(exit code 3\); --resume"):
                workers.call()


def test_none_is_left_after_the_block():
    with WorkerProcesses(f"{HERE}:process", 2) as workers:
        number = workers.call(0.0)
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


STARTS = f"""
import time
from concurrent.futures import ThreadPoolExecutor
from sdm.runtime.worker_processes.pool import WorkerProcesses
with WorkerProcesses("{HERE}:process", 2) as workers, ThreadPoolExecutor(2) as threads:
    print(*threads.map(workers.call, (0.2, 0.2)), flush=True)
    threads.submit(workers.call, 60)
    time.sleep(60)
"""


def test_those_that_are_let_go_of_while_they_start_say_nothing(monkeypatch, capfd):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Connection, "send", interrupted)
    with pytest.raises(KeyboardInterrupt):
        WorkerProcesses(f"{HERE}:process", 2)
    assert capfd.readouterr().err == ""


def test_they_end_with_a_killed_process():
    command = [sys.executable, "-c", STARTS]
    started = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True)
    assert started.stdout is not None
    numbers = [int(word) for word in started.stdout.readline().split()]
    assert len(set(numbers)) == 2
    started.send_signal(signal.SIGKILL)
    started.wait()
    started.stdout.close()
    limit = time.monotonic() + 10
    while any(map(is_there, numbers)) and time.monotonic() < limit:
        time.sleep(0.01)
    assert not any(map(is_there, numbers))


def is_there(number: int) -> bool:
    """True of a process that has not ended; one that nobody has waited for is a zombie."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{number}/status").read_text()
    except OSError:
        return False
