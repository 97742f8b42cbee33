"""Shards as tasks on a Ray cluster: an actor for each GPU (or each machine without one), any of which may be lost."""

from __future__ import annotations

import logging
import re
import signal
import socket
import textwrap
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from sdm.errors import SDMError, one_line
from sdm.runtime.sharing.devices import device_kind
from sdm.runtime.sharing.job import SharedJob

# How often new machines are looked for [s], and how long a cluster may have no worker at all.
LOOK, PATIENCE = 5.0, 120.0
# Workers that a shard may lose, and that may be lost in a row at one place. Counted here and not by Ray's own
# max_task_retries (2.60), which are used up on a machine that is gone before Ray has noticed that it is.
TRIES = 3
# A machine and its port, and how long it has to answer [s].
ADDRESS, KNOCK = re.compile(r"(?:ray://)?(\[.+\]|[^:/]+):(\d+)"), 10.0
# Characters of what Ray says that a sentence has room for.
LONGEST = 240


class Worker:
    """On one GPU of the cluster, or on the CPU of one machine."""

    _maker: Any

    def __init__(self, job: SharedJob, device: str) -> None:
        self._job, self._device = job, device

    def kind(self) -> str:
        """The kind of its device. The first call, which makes it ready: of a constructor Ray hides what went wrong."""
        self._job.check()
        self._maker = self._job.maker(self._device)
        return device_kind(self._device)

    def make(self, number: int) -> Any:
        """Do a shard; what the job tells of it."""
        told: list[Any] = []
        self._job.run([number], self._maker, told.append)
        return told[0]


def run_on_ray(job: SharedJob, shards: list[int], address: str, done: Callable[[Any], None]) -> None:
    """Do shards on a Ray cluster; a shard whose worker is lost goes to another.

    Args:
        job: The work.
        shards: Their numbers.
        address: Of the cluster.
        done: Called with what the job tells of each, in whatever order they end.

    Raises:
        SDMError: Ray is not installed, no cluster is there, its GPUs differ, workers are lost again and again, or a
            shard cannot be made.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise SDMError("--ray needs Ray, which is not installed: pip install '.[ray]' in a clone") from None
    own = not ray.is_initialized()
    if own:
        _knock(address)
        before = signal.getsignal(signal.SIGTERM)
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise SDMError(f"there is no Ray cluster at {address!r}: {one_line(error)}") from error
        _handle_termination_by(before)
    try:
        # Workers are in folders of their own.
        _Crew(ray, job.absolute(), done).run(list(reversed(shards)))
    finally:
        if own:
            ray.shutdown()


def _handle_termination_by(handler: Any) -> None:
    """Take SIGTERM back from Ray, one of whose two handlers exits with 15, and the other aborts with a dump."""
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)


def _knock(address: str) -> None:
    """Ray itself waits minutes for an address where nothing answers, and says nothing."""
    place = ADDRESS.fullmatch(address)
    if place is None:
        return
    try:
        socket.create_connection((place[1].strip("[]"), int(place[2])), timeout=KNOCK).close()
    # A port beyond those that there are is an OverflowError.
    except (OSError, OverflowError) as error:
        raise SDMError(f"there is no Ray cluster at {address!r}: {one_line(error)}") from error


class _Crew:
    """The workers, and what each is doing."""

    def __init__(self, ray: Any, job: SharedJob, done: Callable[[Any], None]) -> None:
        self._ray, self._job, self._done = ray, job, done
        self._shared = ray.put(job)
        # By place (node and number there): the actor. By task: its place, and the shard or None for the greeting.
        self._actors: dict[tuple[str, int], Any] = {}
        self._tasks: dict[Any, tuple[tuple[str, int], int | None]] = {}
        self._idle: list[tuple[str, int]] = []
        # Workers lost by shard, and by place since one there did its work; what was said of the last one.
        self._lost: Counter[int | tuple[str, int]] = Counter()
        self._reason = ""

    def run(self, todo: list[int]) -> None:
        left = len(todo)
        looked = seen = 0.0
        while left:
            if time.monotonic() - looked > LOOK:
                self._recruit()
                looked = time.monotonic()
            if self._actors:
                seen = time.monotonic()
            elif seen and time.monotonic() - seen > PATIENCE:
                raise SDMError("the Ray cluster has lost every worker; --resume goes on from there")
            elif not seen:
                raise SDMError("the Ray cluster has neither a GPU nor a CPU to work on")
            ready, _ = self._ray.wait(list(self._tasks), timeout=LOOK) if self._tasks else ([], [])
            if not self._tasks:
                time.sleep(LOOK / 5)
            for task in ready:
                left -= self._hear(task, todo)

    def _hear(self, task: Any, todo: list[int]) -> int:
        """Outcome of a task: 1 if a shard is done."""
        place, number = self._tasks.pop(task)
        try:
            answer = self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:
            raise SDMError(str(error.cause)) from error
        except self._ray.exceptions.RayError as error:
            # Its machine or its process is gone: whatever it has written of the shard is written again.
            self._lose(place, number, error)
            if number is not None:
                todo.append(number)
            self._hand_out(todo)
            return 0
        if number is None:
            self._job.agree(answer)
        else:
            del self._lost[place]
            self._done(answer)
        self._idle.append(place)
        self._hand_out(todo)
        return number is not None

    def _lose(self, place: tuple[str, int], number: int | None, error: Exception) -> None:
        self._actors.pop(place, None)
        # Ray tells a story of many lines; the last one has what happened, and then what often is the cause.
        lines = [line for line in str(error).splitlines() if line.strip()] or [repr(error)]
        self._reason = textwrap.shorten(lines[-1], LONGEST, placeholder=" ...")
        if getattr(error, "actor_init_failed", False):
            raise SDMError(f"a worker of the Ray cluster cannot start: {self._reason}") from error
        self._lost[place] += 1
        if number is None:
            return
        self._lost[number] += 1
        if self._lost[number] >= TRIES:
            raise SDMError(
                f"shard {number} has lost {TRIES} workers, the last one to this: {self._reason}; "
                "--resume goes on from there"
            ) from error

    def _hand_out(self, todo: list[int]) -> None:
        while todo and self._idle:
            place = self._idle.pop()
            if place in self._actors:
                number = todo.pop()
                self._tasks[self._actors[place].make.remote(number)] = place, number

    def _recruit(self) -> None:
        """An actor at every place that has none: each GPU, or each machine if the cluster has no GPU."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy  # pyright: ignore[reportMissingImports]

        nodes = [n for n in self._ray.nodes() if n["Alive"]]
        name = "GPU" if any(n["Resources"].get("GPU", 0) >= 1 for n in nodes) else "CPU"
        given_up = False
        for node in nodes:
            have = int(node["Resources"].get(name, 0))
            for number in range(have if name == "GPU" else min(have, 1)):
                place = (node["NodeID"], number)
                if place in self._actors:
                    continue
                if self._lost[place] >= TRIES:
                    given_up = True
                    continue
                strategy = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                needs = {"num_gpus": 1, "num_cpus": 0} if name == "GPU" else {"num_cpus": 1}
                actor = self._ray.remote(Worker).options(scheduling_strategy=strategy, **needs)
                self._actors[place] = actor.remote(self._shared, "cuda:0" if name == "GPU" else "cpu")
                self._tasks[self._actors[place].kind.remote()] = place, None
        if given_up and not self._actors:
            raise SDMError(
                f"the Ray cluster loses its workers again and again, the last one to this: {self._reason}; "
                "--resume goes on from there"
            )
