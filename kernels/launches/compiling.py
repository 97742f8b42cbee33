"""Notice that kernels are being compiled, so that nobody takes the first call of an installation for a hang."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Seconds that loading a module may take before something is said: what is compiled already takes a tenth.
PATIENCE = 3.0
_logger = logging.getLogger("sdm")
_said: set[str] = set()
EVERY_DEVICE = "every device"


def keep_silent() -> None:
    """Say nothing of compiling from now on: who uses the kernels says it in another way."""
    _said.add(EVERY_DEVICE)


def _say(device: str) -> None:
    if device not in _said and EVERY_DEVICE not in _said:
        _said.add(device)
        _logger.warning(
            "sdm compiles its kernels for %s: about ten seconds for a first map, longer on a busy machine; later calls "
            "and processes find them (Warp's cache, or WARP_CACHE_PATH)",
            device,
        )


@contextmanager
def noticed(device: str) -> Iterator[None]:
    """Say once for a device that kernels are compiled, by the logger `sdm`, if what is done inside takes long."""
    if device in _said:
        yield
        return
    timer = threading.Timer(PATIENCE, _say, [device])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
