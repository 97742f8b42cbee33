"""Launches recorded once and filled in again: half the host's time of `wp.launch`, or less.

Each thread has one recorded launch of each kernel, device and size of block. What it is to be launched with next is
written into its parameters: numbers in place, arrays and structs by the addresses of their descriptors. An argument
that is the same object as the last time is there already, whatever was written into it since.
"""

from __future__ import annotations

import ctypes
import os
import threading
from typing import Any

import warp as wp
from warp._src import context as warp_context

from sdm.kernels.launches.compiling import noticed
from sdm.kernels.launches.shared_hashes import share_hashes

# Warp loads a module twice if two threads want it at once, and takes back the one while it runs.
loading = threading.RLock()
# `wp.Launch.launch` of these versions is the call below, and looks for recordings and gradients that are not here.
_KNOWN_VERSIONS = frozenset(("1.19.0",))
_PLAIN = wp.Launch.launch
_nothing = object()
share_hashes()


def _unlock() -> None:
    """A fork's copy of the lock may be held by a thread that the fork has not."""
    global loading  # noqa: PLW0603
    loading = threading.RLock()


# Windows has no forks.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_unlock)


class RecordedLaunch:
    """A recorded launch of a kernel with one axis of threads.

    Args:
        command: What `wp.launch(..., record_cmd=True)` gave.
        kernel: The kernel.
    """

    __slots__ = ("_addresses", "_call", "_command", "_known", "_params", "_types", "kernel")

    def __init__(self, command: Any, kernel: wp.Kernel) -> None:
        # It would keep the arrays of this first launch alive.
        command.fwd_args = None
        self.kernel, self._command = kernel, command
        self._types = [(a.type, getattr(a.type, "instance_type", None)) for a in kernel.adj.args]
        self._known: list[Any] = [_nothing] * len(self._types)
        self._params, self._addresses = command.params, command.params_addr
        self._call: Any = None
        if command.device.is_cuda and wp.__version__ in _KNOWN_VERSIONS:
            hooks = command.hooks
            self._call = (
                command.device.context,
                hooks.forward,
                (
                    command.max_blocks,
                    command.block_dim,
                    int(command.grid_stride),
                    command.cluster_dim,
                    hooks.forward_smem_bytes,
                    command.params_addr,
                ),
            )

    def launch(self, count: int, values: list[Any]) -> None:
        """Launch `count` threads with these arguments."""
        known = self._known
        if len(values) != len(known):
            raise RuntimeError(f"{self.kernel.key} takes {len(known)} arguments, not {len(values)}")
        command = self._command
        if command.bounds.size != count:
            self._set_count(count)
        place = 0
        for value in values:
            if value is not known[place]:
                self._fill(place, value)
            place += 1
        call = self._call
        # Whoever watches launches sees them.
        if call is None or wp.Launch.launch is not _PLAIN:
            command.launch()
        else:
            of_device, kernel, rest = call
            stream = command.device.stream.cuda_stream
            if warp_context.runtime.captures:
                self._keep_module(stream)
            if warp_context.runtime.core.wp_cuda_launch_kernel(of_device, kernel, count, *rest, stream, None):
                # Once more, for the error.
                command.launch()

    def _keep_module(self, stream: int) -> None:
        """As Warp does: the module of what is being recorded on a stream stays as long as the recording."""
        runtime = warp_context.runtime
        if runtime.core.wp_cuda_stream_is_capturing(stream):
            graph = runtime.captures.get(runtime.core.wp_cuda_stream_get_capture_id(stream))
            if graph is not None:
                graph._retain_module_exec(self._command.module_exec)

    def _set_count(self, count: int) -> None:
        bounds = self._command.bounds
        if count < 1 << 31:
            bounds.shape[0] = bounds.size = count
        else:
            self._command.set_dim(count)

    def _fill(self, place: int, value: Any) -> None:
        """Write one argument."""
        known, kind = self._known, type(value)
        wanted, struct = self._types[place]
        if kind is int and wanted is wp.int32:
            # In place: nobody else has this number, and its address stays.
            self._params[place + 1].value = value
            known[place] = value
            return
        known[place] = _nothing
        if kind is struct:
            packed = value._ctype
        elif kind is wp.array and value.dtype is wanted.dtype and value.ndim == wanted.ndim:
            packed = value.__ctype__()
        else:
            # Whatever else there is, errors among it, is left to Warp.
            self._command.set_param_at_index(place, value)
            return
        self._params[place + 1] = packed
        if self._addresses:
            self._addresses[place + 1] = ctypes.addressof(packed)
        # Memory that an array owns is not kept for the next launch.
        if kind is struct or value.deleter is None:
            known[place] = value


class _Recorded(threading.local):
    """The launches that a thread has recorded. No two threads share any, as each fills in its own."""

    def __init__(self) -> None:
        self.known: dict[tuple[wp.Kernel, str, int], RecordedLaunch] = {}


_recorded = _Recorded()


def run(kernel: wp.Kernel, count: int, values: list[Any], device: wp.Device, block_dim: int) -> None:
    """`wp.launch` of a kernel with one axis of threads."""
    key = kernel, device.alias, block_dim
    known = _recorded.known.get(key)
    if known is not None:
        known.launch(count, values)
        return
    with loading, noticed(device.alias):
        command: Any = wp.launch(kernel, count, values, device=device, block_dim=block_dim, record_cmd=True)
    # Warp's deterministic mode records something else, which is left alone.
    if type(command) is wp.Launch:
        _recorded.known[key] = RecordedLaunch(command, kernel)
    command.launch()
