"""Hashes of the package's functions, worked out once in a process.

Before a module of kernels is loaded Warp hashes its kernels and all functions that they call, to know whether the
compiled kernels of its cache are theirs. Each module does that by itself, so a function that forty modules call is gone
through forty times. Its hash depends on its source, its arguments and what it refers to, which are the same for every
module: of 1,539 functions and kernels of 45 modules 473 differ.
"""
# pyright: basic

from __future__ import annotations

import functools
from typing import Any

import warp as wp
from warp._src import context as warp_context

# `ModuleHasher` of these versions is what is said above.
_KNOWN_VERSIONS = frozenset(("1.19.0",))
_OURS = __name__.partition(".launches")[0] + "."
_known: dict[Any, bytes] = {}


def share_hashes() -> None:
    """From now on modules that are loaded share the hashes of this package's functions. Others' are left alone."""
    if wp.__version__ not in _KNOWN_VERSIONS:
        return
    hasher: Any = warp_context.ModuleHasher
    plain = hasher.hash_function
    if hasattr(plain, "__wrapped__"):
        return

    @functools.wraps(plain)
    def hash_function(self: Any, func: Any) -> bytes:
        found = _known.get(func)
        if found is None:
            found = plain(self, func)
            if func.module is not None and func.module.name.startswith(_OURS):
                _known[func] = found
        return found

    hasher.hash_function = hash_function
