"""Fuzz the readers and the numerics: `python -m sdm.bench.fuzz --minutes 10 --out FILE.json`.

Parts: `mesh_files`, `map_files`, `datasets`, `models` (damage to bytes: right, or refused in one sentence), `numerics`
(random nasty meshes against the float64 brute force) and `near_degenerate` (slivers and T-junctions against exact
rational arithmetic). Trial number n of a seed is always the same, whatever came before it: `--first n --trials 1` runs
it again.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fuzz.trial import Finding, Outcome
from sdm.core.random import derive_seed

PARTS = ("numerics", "near_degenerate", "mesh_files", "map_files", "datasets", "models")
NUMERIC = {"numerics", "near_degenerate"}
# A trial that takes longer hangs, as far as a user is concerned.
MOST_SECONDS = 30.0


def run_trial(part: str, seed: int, number: int) -> tuple[Outcome | None, str]:
    """One trial in a folder of its own: its outcome, or the finding's sentence."""
    rng = np.random.default_rng(derive_seed(seed, "fuzz", part, number))
    started = np.array([time.monotonic(), time.process_time()])
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            outcome = importlib.import_module(f"sdm.bench.fuzz.{part}").trial(rng, Path(folder))
        except Finding as finding:
            return None, str(finding)
    # By the clock and in work: on a busy machine the clock alone says nothing.
    took = float((np.array([time.monotonic(), time.process_time()]) - started).min())
    return (None, f"{outcome.kind}: took {took:.0f} s") if took > MOST_SECONDS else (outcome, "")


def fuzz(parts: Sequence[str], seed: int, minutes: float, first: int = 0, trials: int | None = None) -> dict[str, Any]:
    """Run trials of the parts by turns until the time is over; what was tried, refused and found."""
    for part in sorted(NUMERIC & set(parts)):
        # Kernels compile once, which is no trial's fault.
        run_trial(part, seed, first)
    report: dict[str, Any] = {part: {"trials": 0, "refused": 0, "kinds": Counter(), "findings": []} for part in parts}
    stop = time.monotonic() + 60 * minutes
    number = first
    while time.monotonic() < stop and (trials is None or number < first + trials):
        for part in parts:
            outcome, sentence = run_trial(part, seed, number)
            row = report[part]
            row["trials"] += 1
            if outcome is None:
                row["findings"].append({"trial": number, "finding": sentence})
                print(f"{part} {number}: {sentence}", file=sys.stderr, flush=True)
            else:
                row["refused"] += outcome.refused
                row["kinds"][outcome.kind] += 1
        number += 1
    return report


def main(argv: Sequence[str] | None = None) -> int:
    """As the module says; 1 if something was found."""
    parser = argparse.ArgumentParser("python -m sdm.bench.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=0.5, help="how long")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="which trials")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--trials", type=int, help="most trials of each part")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args(argv)
    report = fuzz(options.parts, options.seed, options.minutes, options.first, options.trials)
    found = sum(len(row["findings"]) for row in report.values())
    for part, row in report.items():
        print(f"{part:12} {row['trials']:6} trials, {row['refused']:6} refused, {len(row['findings']):4} findings")
    if options.out is not None:
        plain = json.loads(json.dumps(report))
        write(
            options.out, {"machine": describe("cpu"), "seed": options.seed, "minutes": options.minutes, "parts": plain}
        )
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
