"""Output of compute-sanitizer and ncu as the commands read it, without a GPU."""

from __future__ import annotations

import gzip
import json

import pytest
import torch

from sdm.bench.gpu import gpu_work, profile_kernels, profile_source, sanitize

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


def test_the_work_is_fine_on_a_cpu():
    assert gpu_work.small(6, "cpu") == 4 * len(gpu_work.MESHES) + 2


def source_page(kernel, rows):
    """ncu's page of a launch's machine code: instructions, times, samples that wait for memory and for instructions."""
    header = ["Address", "Source", "# Samples", "Instructions Executed", "Thread Instructions Executed"]
    header += ["stall_long_sb", "stall_no_inst", "stall_selected"]
    lines = [f'"Kernel Name","{kernel}",', ",".join(f'"{name}"' for name in header)]
    for i, (source, times, memory, fetch) in enumerate(rows):
        cells = [f"0x{i:x}", source, memory + fetch, times, 32 * times, memory, fetch, 0]
        lines.append(",".join(f'"{cell}"' for cell in cells))
    return "\n".join(lines)


def test_stretches_of_machine_code():
    loop = [("@!P0 FFMA.FTZ R1, R2", 1000, 0, 30), ("LDS.128 R4, [R3]", 1000, 70, 0), ("@P1 BRA 0x10", 950, 0, 0)]
    page = source_page("measure", [("MOV R1, R2", 10, 0, 0), *loop, ("EXIT", 10, 0, 0), ("NOP", 0, 0, 0)])
    others = source_page("cells", [("MOV R1, R2", 1, 1, 0)])
    (launch,) = profile_source.read_source(f"{page}\n{others}\n{page}\n{page}", "meas")[:1]
    assert (launch["instructions"], launch["executed_instructions"], launch["executions"]) == (6, 5, 2970)
    assert launch["lanes"] == 32
    assert launch["waits"] == {"memory": pytest.approx(0.7), "instructions": pytest.approx(0.3)}
    (stretch,) = launch["stretches"]
    assert (stretch["first"], stretch["instructions"], stretch["samples"]) == (1, 3, 1.0)
    assert stretch["most"] == ["FFMA 1", "LDS 1", "BRA 1"]
    # ncu may tell of one launch twice.
    assert len(profile_source.read_source(f"{page}\n{page}\n{others}", "meas")) == 1


def test_a_page_that_was_written_before(tmp_path, capsys):
    path, out = tmp_path / "page.csv.gz", tmp_path / "source.json"
    path.write_bytes(gzip.compress(source_page("measure", [("MOV R1, R2", 10, 3, 0)]).encode()))
    assert profile_source.main(["--read", str(path), "--kernel", "measure", "--out", str(out)]) == 0
    assert "1 of 1 instructions are executed" in capsys.readouterr().out
    assert json.loads(out.read_text())["launches"][0]["samples"] == 3
    assert profile_source.main(["--read", str(path), "--kernel", "other"]) == 2
    assert profile_source.main(["--read", str(tmp_path / "none.csv")]) == 2
    assert profile_source.main(["torus"]) == 2
    path.write_bytes(path.read_bytes()[:-9])
    assert profile_source.main(["--read", str(path), "--kernel", "measure"]) == 2
    assert capsys.readouterr().err.count("\n") == 4
