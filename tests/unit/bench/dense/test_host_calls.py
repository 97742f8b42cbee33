"""The way from a call to its first kernel stays short."""

from __future__ import annotations

import pytest

from sdm.bench.dense.host_calls import calls, measured

# Functions and files of the project before the first launch, and in a whole call.
LIMITS = {
    # Up to the first launch with the way out of the guard of the memory, which the end there enters.
    "signed_distance_maps, mesh seen before": ((22, 9), (61, 27)),
    "signed_distance_map, mesh seen before": ((30, 15), (91, 35)),
    "signed_distance_map, new mesh": ((24, 12), (103, 36)),
}


@pytest.mark.parametrize("name", LIMITS)
def test_few_functions(name):
    call = calls(500, 24)[name]
    # Kernels are compiled and loaded by calls that launch them.
    call()()
    found = measured(call, repeats=1)
    for host, (functions, files) in zip((found.before, found.whole), LIMITS[name], strict=True):
        assert 0 < host.functions <= functions
        assert 0 < host.files <= files
