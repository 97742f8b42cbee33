"""The stream's benchmark runs, on small sizes where there is no GPU, and writes what it found."""

from __future__ import annotations

import json

import pytest
import torch


@pytest.mark.slow
@pytest.mark.skipif(torch.cuda.is_available(), reason="on a GPU it takes minutes")
def test_it_runs_and_writes_its_results(tmp_path, monkeypatch):
    pytest.importorskip("rtree", reason="needs the extra bench")
    from bench.stream import main

    out = tmp_path / "stream.json"
    monkeypatch.setattr("sys.argv", ["stream", "--parts", "rates", "training", "--device", "cpu", "--out", str(out)])
    main()
    found = json.loads(out.read_text())
    assert all(row["maps_per_second"] > 0 for row in found["rates"]["batches"])
    assert found["training"]["streamed_to_cached"] > 0
    assert found["machine"]["versions"]["torch"]
