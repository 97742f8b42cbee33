"""What the commands for compute-sanitizer and ncu make of those tools' words, without a GPU."""

from __future__ import annotations

import pytest
import torch

from bench import _gpu_work, profile_kernels, sanitize

CLEAN = "========= COMPUTE-SANITIZER\n22 of 22 results are finite\n========= ERROR SUMMARY: 0 errors\n"
BROKEN = "========= Invalid __global__ read of size 4 bytes\n========= ERROR SUMMARY: 3 errors\n"
NO_RACE = "========= RACECHECK SUMMARY: 0 hazards displayed (0 errors, 0 warnings)\n"
RACE = "========= RACECHECK SUMMARY: 2 hazards displayed (1 error, 1 warning)\n"


@pytest.mark.parametrize(
    ("code", "said", "clean"),
    [
        (0, CLEAN, True),
        (86, BROKEN, False),
        (0, NO_RACE, True),
        (86, RACE, False),
        (0, RACE, False),
        (1, CLEAN, None),
        (0, "nothing was watched", None),
        (-11, "", None),
    ],
)
def test_verdicts(code, said, clean):
    assert sanitize.judge(code, said)["clean"] is clean


def test_ncus_page():
    names = profile_kernels.METRICS
    header = ["ID", "Kernel Name", *names.values()]
    units = ["", "", "ns", *["%"] * (len(names) - 1)]
    rows = [
        ["0", "cells", "1000000", *["10"] * (len(names) - 1)],
        ["1", "cells", "3000000", *["50"] * (len(names) - 1)],
    ]
    rows.append(["2", "bricks", "2,000,000", *["n/a"] * (len(names) - 1)])
    text = "==PROF== Connected\n" + "\n".join(",".join(f'"{x}"' for x in row) for row in (header, units, *rows))
    cells, bricks = profile_kernels.read_ncu(text)
    assert (cells["kernel"], cells["calls"], cells["ms"]) == ("cells", 2, pytest.approx(4))
    assert cells["dram_percent"] == pytest.approx(40)
    assert bricks["ms"] == pytest.approx(2)
    assert profile_kernels.read_ncu("==ERROR== no permission") == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="says what it says without a GPU")
def test_without_a_gpu(capsys):
    assert sanitize.main([]) == 2
    assert profile_kernels.main([]) == 2
    assert "no CUDA device" in capsys.readouterr().err


def test_the_work_is_fine_on_a_cpu(monkeypatch):
    import sdm.ops

    monkeypatch.setattr(sdm.ops, "DENSE_METHOD", "auto")
    assert _gpu_work.small(6, "cpu") == 4 * len(_gpu_work.MESHES) + 2
