"""The host's way from a first map's call on a GPU to its launch stays short."""

from __future__ import annotations

import torch

from sdm.bench.gpu.first_map_host import measured
from sdm.runtime import graphs
from sdm.runtime.graphs import replay

# Functions of the project before the launch: each takes a host whose caches are empty some two microseconds.
MOST = 10


def test_few_functions_before_the_launch():
    before = replay.TableRecording, graphs.supports, torch.Tensor.record_stream
    way = measured(500, calls=4, other_ms=1.0)
    names = [name for _, name in way.functions]
    assert names[0] == "_plain_map"
    assert "TableRecording.launch" in names
    assert names[-1] == "write_table"
    assert len(names) <= MOST
    assert way.warm_us > 0
    assert way.cold_us > 0
    # As it was before.
    assert before == (replay.TableRecording, graphs.supports, torch.Tensor.record_stream)
