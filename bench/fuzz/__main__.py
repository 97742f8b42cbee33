"""Fuzz the readers and the numerics: `python -m sdm.bench.fuzz --minutes 10 --out FILE.json`.

Parts: `mesh_files`, `map_files`, `bands`, `datasets`, `models` (damage to bytes: right, or refused in one sentence),
`numerics` (random nasty meshes against the float64 brute force), `near_degenerate` (slivers and T-junctions against
exact rational arithmetic) and `paths` (dirty meshes by first, repeated, recorded and joint calls, all of the same bits,
on a GPU where there is one). Trial number n of a seed is always the same, whatever came before it: `--first n
--trials 1` runs it again. `--minutes` are those of all processes together: `--minutes 60 --processes 12` ends after
five.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fuzz.runs import PARTS, fuzz, fuzz_in_processes


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 1 if something was found."""
    parser = argparse.ArgumentParser("python -m sdm.bench.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=0.5, help="how long, all processes together")
    parser.add_argument("--processes", type=int, default=1, help="how many at once, a thread each")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="which trials")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--trials", type=int, help="most trials of each part")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args(argv)
    what = (options.parts, options.seed, options.minutes, options.first, options.trials)
    report = fuzz(*what) if options.processes == 1 else fuzz_in_processes(options.processes, *what)
    found = sum(len(row["findings"]) for row in report.values())
    for part, row in report.items():
        print(f"{part:12} {row['trials']:6} trials, {row['refused']:6} refused, {len(row['findings']):4} findings")
    if options.out is not None:
        plain = json.loads(json.dumps(report))
        setting = {name: getattr(options, name) for name in ("seed", "minutes", "processes")}
        write(options.out, {"machine": describe("cpu"), **setting, "parts": plain})
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
