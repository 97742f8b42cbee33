"""Stalls of a GPU kernel's instructions: `python -m sdm.bench.gpu.profile_source nefertiti:256 --kernel NAME`.

ncu samples which instruction each warp is at, and why it does not go on. Here these samples are added up for stretches
of machine code that are executed equally often, as in the same loop, beside the share of executed instructions, the
lanes that take part, and the instructions that stand there most: enough to tell which part of the source it is. The
first lines say how much code is executed at all; what does not fit into a multiprocessor's cache for instructions has
to be waited for ("instructions"). `--read` takes what `ncu --page source --csv` wrote before, gzipped or not.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import markdown_table
from sdm.bench.gpu import ncu
from sdm.bench.gpu.sanitize import find_tool
from sdm.errors import SDMError

# ncu's reasons, in words; the others are rare.
WAITS = {
    "long_sb": "memory",
    "short_sb": "shared memory",
    "wait": "the one before",
    "no_inst": "instructions",
    "branch_resolving": "branches",
    "math": "busy units",
    "dispatch": "dispatch",
    "mio": "memory queue",
    "barrier": "barriers",
    "not_selected": "another warp's turn",
    "selected": "nothing",
}
# Bytes of an instruction since Volta.
INSTRUCTION = 16
# A stretch ends where the next instruction is executed so much more or less often.
APART = 0.25
# Stretches with less than this share of instructions and of samples are not told.
SMALLEST = 0.015

Row = dict[str, str]


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 2 if there is nothing to read."""
    parser = argparse.ArgumentParser(
        "python -m sdm.bench.gpu.profile_source", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument(
        "case", nargs="?", default="nefertiti:256", metavar="MESH:N", help="of a warm map of a new mesh"
    )
    parser.add_argument("--kernel", default="_measure_blocks", help="part of its name")
    parser.add_argument("--read", type=Path, help="what ncu wrote before, in place of a run")
    parser.add_argument("--timeout-s", type=float, default=120.0, help="longest time of ncu")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    try:
        text = _text_of(options.read) if options.read else watched(options.case, options.kernel, options.timeout_s)
        launches = read_source(text, options.kernel)
        if not launches:
            raise SDMError(f"there is no launch of a kernel with {options.kernel!r} in its name")
    except SDMError as error:
        print(error, file=sys.stderr)
        return 2
    for launch in launches:
        _print(launch)
    if options.out is not None:
        origin = {"read": options.read.name} if options.read else {"case": options.case, **describe("cuda")}
        write(options.out, {**origin, "launches": launches})
    return 0


def watched(case: str, kernel: str, timeout_s: float) -> str:
    """ncu's page of the machine code of the launches of one warm map, as CSV."""
    name, resolution = ncu.case_of(case)
    program = find_tool("ncu")
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.ncu-rep"
        command = [program, "--profile-from-start", "off", "--kernel-name", f"regex:{kernel}"]
        command += ["--section", "SourceCounters", "--import-source", "no", "-o", str(report)]
        done = ncu.run(command, name, resolution, timeout_s)
        if not report.is_file():
            raise SDMError(ncu.complaint(done, "report"))
        page = [program, "--import", str(report), "--page", "source", "--csv"]
        return subprocess.run(page, check=False, capture_output=True, text=True).stdout


def _text_of(path: Path) -> str:
    if not path.is_file():
        raise SDMError(f"there is no file {path}")
    data = path.read_bytes()
    try:
        return (gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data).decode()
    except (OSError, EOFError, UnicodeDecodeError):
        raise SDMError(f"{path} is not text, gzipped or not: give what ncu --page source --csv wrote") from None


def read_source(text: str, kernel: str) -> list[dict[str, Any]]:
    """The launches of kernels with `kernel` in their names, from ncu's page; it may tell of one twice."""
    lines = text.splitlines()
    starts = [i for i, line in enumerate(lines) if line.startswith('"Kernel Name"')]
    found: list[dict[str, Any]] = []
    for begin, end in pairwise([*starts, len(lines)]):
        name = lines[begin].split('","')[1].rstrip('",')
        if kernel not in name:
            continue
        launch = launch_of(name, list(csv.DictReader(io.StringIO("\n".join(lines[begin + 1 : end])))))
        if not found or found[-1] != launch:
            found.append(launch)
    return found


def launch_of(name: str, rows: Sequence[Row]) -> dict[str, Any]:
    """One launch: how much code there is and is executed, what its warps wait for, and its stretches."""
    total = sum(_number(row, "Instructions Executed") for row in rows)
    threads = sum(_number(row, "Thread Instructions Executed") for row in rows)
    executed = sum(_number(row, "Instructions Executed") > 0 for row in rows)
    samples = sum(_number(row, "# Samples") for row in rows)
    return {
        "kernel": name,
        "instructions": len(rows),
        "executed_instructions": executed,
        "executed_kib": executed * INSTRUCTION / 1024,
        "executions": total,
        "lanes": threads / max(total, 1),
        "samples": samples,
        "waits": waits(rows),
        "stretches": [
            told
            for first, stretch in stretches(rows)
            if max((told := _told(first, stretch, total, samples))["executions"], told["samples"]) >= SMALLEST
        ],
    }


def stretches(rows: Sequence[Row]) -> Iterator[tuple[int, Sequence[Row]]]:
    """Runs of instructions that are executed equally often, or nearly: the first one's number, and the run."""
    begin = 0
    for i in range(1, len(rows) + 1):
        if i < len(rows):
            one, other = (_number(row, "Instructions Executed") for row in (rows[i - 1], rows[i]))
            if abs(one - other) <= APART * max(one, other):
                continue
        yield begin, rows[begin:i]
        begin = i


def _told(first: int, rows: Sequence[Row], total: int, samples: int) -> dict[str, Any]:
    executions = sum(_number(row, "Instructions Executed") for row in rows)
    threads = sum(_number(row, "Thread Instructions Executed") for row in rows)
    names = Counter(_operation(row["Source"]) for row in rows)
    return {
        "first": first,
        "instructions": len(rows),
        "times": executions // len(rows),
        "executions": executions / max(total, 1),
        "samples": sum(_number(row, "# Samples") for row in rows) / max(samples, 1),
        "lanes": threads / max(executions, 1),
        "most": [f"{name} {count}" for name, count in names.most_common(4)],
        "waits": dict(list(waits(rows).items())[:3]),
    }


def waits(rows: Sequence[Row]) -> dict[str, float]:
    """The share of each reason among the samples, largest first."""
    sums = {told: sum(_number(row, f"stall_{name}") for row in rows) for name, told in WAITS.items()}
    total = sum(sums.values())
    ordered = sorted(sums.items(), key=lambda item: -item[1])
    return {name: value / total for name, value in ordered if value}


def _operation(source: str) -> str:
    """The instruction's name, without its predicate and its endings."""
    words = source.split()
    return words[1 if words[0].startswith("@") else 0].split(".")[0]


def _number(row: Row, key: str) -> int:
    text = (row.get(key) or "0").replace(",", "")
    return int(text) if text.isdigit() else 0


def _print(launch: dict[str, Any]) -> None:
    print(
        f"\n{launch['kernel']}: {launch['executed_instructions']:,} of {launch['instructions']:,} instructions are "
        f"executed ({launch['executed_kib']:.0f} KiB), {launch['executions']:,} times in all by {launch['lanes']:.1f} "
        f"lanes; waiting for {_shares(launch['waits'])}\n"
    )
    header = ["from", "instructions", "times", "of all", "samples", "lanes", "most", "waiting for"]
    rows = [
        [
            str(stretch["first"]),
            str(stretch["instructions"]),
            f"{stretch['times']:,}",
            f"{stretch['executions']:.1%}",
            f"{stretch['samples']:.1%}",
            f"{stretch['lanes']:.1f}",
            ", ".join(stretch["most"]),
            _shares(stretch["waits"]),
        ]
        for stretch in launch["stretches"]
    ]
    print(markdown_table(header, rows))


def _shares(shares: dict[str, float]) -> str:
    return ", ".join(f"{name} {share:.0%}" for name, share in shares.items() if share >= 0.01)


if __name__ == "__main__":
    sys.exit(main())
