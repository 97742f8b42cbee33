"""Kernels compiled at the beginning of a parallel run that finds none in Warp's cache, each by one of its processes.

Else all processes compile nearly all kernels: each as its next test launches them, and none knows of the others.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from warp._src import context

from sdm import kernels

# So many tests are a whole run, which launches nearly all kernels.
MANY_TESTS = 1500
# With as many modules in the cache most are there.
ENOUGH = 20
# What no test launches on a CPU.
NOT_ON_CPU = "sdm.kernels.nanovdb"
# Modules that a process has loaded as it begins with the first test.
AT_COLLECTION = pytest.StashKey[list[str]]()


def compile_missing(shared: Path) -> None:
    """Compile those modules that no other process has begun with; `shared` is a folder of the run's processes."""
    if not any(shared.iterdir()) and sum(1 for _ in Path(str(wp.config.kernel_cache_dir)).glob("wp_*")) >= ENOUGH:
        return
    for found in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}."):
        importlib.import_module(found.name)
    for module in _modules():
        if claim(shared / module.name):
            module.load(wp.get_device("cpu"), 1)


def loaded() -> list[str]:
    """Names of the modules that this process has loaded."""
    return sorted(module.name for module in context.user_modules.values() if module.execs)


def _modules() -> Iterator[Any]:
    for module in list(context.user_modules.values()):
        homes = {kernel.func.__module__ for kernel in module.kernels.values()}
        if homes and all(home.startswith(f"{kernels.__name__}.") for home in homes) and NOT_ON_CPU not in homes:
            yield module


def claim(path: Path) -> bool:
    """True for the first that asks for this name."""
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True
