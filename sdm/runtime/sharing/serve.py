"""Loop of a process that another one shares work with: it imports what it will need, and then takes shards.

What is imported here is what a process waits for before it watches whether the one that started it is still there.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Iterator
from importlib import import_module
from multiprocessing.connection import Connection

from sdm.errors import SDMError
from sdm.runtime import early_device, torch_libraries
from sdm.runtime.sharing.job import SharedJob

# As of commands, see `sdm.cli.app`.
GARBAGE_THRESHOLDS = (10_000, 10, 10)


def serve(link: Connection, imports: str, device: str) -> None:
    """Take a job and its device, and ask for shards of it until there are none.

    Args:
        link: To the process that shares its work.
        imports: A module that the job needs, to be imported before it is there.
        device: To be made ready meanwhile, as it will probably be the job's.
    """
    # An interrupt is the first process's to take, which ends this one; and it must not work on if that was killed.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Locks that libraries make have a name on the system otherwise, of which Python warns once this process is ended.
    if "fork" in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("fork", force=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # To look for garbage among a million new objects that stay takes a quarter of the import.
    gc.disable()
    torch_libraries.begin()
    # Warp starts beside them.
    import_module("sdm.kernels")
    early_device.begin(device)
    import_module(imports)
    import torch

    # Beside others it has not all cores.
    torch.set_num_threads(1)

    def shards() -> Iterator[int]:
        while True:
            link.send(("next", None))
            number = pickle.loads(_received(link))  # noqa: S301
            if number is None:
                return
            yield number

    try:
        # From the process that started this one.
        given: tuple[SharedJob, str] = pickle.loads(_received(link))  # noqa: S301
        job, device = given
        gc.freeze()
        gc.set_threshold(*GARBAGE_THRESHOLDS)
        gc.enable()
        job.run(shards(), job.maker(device), lambda told: link.send(("done", told)))
    except SDMError as error:
        link.send(("error", str(error)))
    link.send(("end", None))


def _received(link: Connection) -> bytes:
    try:
        return link.recv_bytes()
    except (EOFError, OSError):
        # As `_end_with_parent`, which may not have seen it yet.
        os._exit(1)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
