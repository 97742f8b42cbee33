"""Errors and times of the cochlea's surrogates.

    python -m sdm.bench.surrogate --parts accuracy --weights RUN/*.safetensors [--count 1000] [--pod 4096]
    python -m sdm.bench.surrogate --parts timing [--threads 2]

- `accuracy`: all weights that are named (by default the shipped ones), and the exact maps themselves as the floor of
  the surface's measures, on the first `--count` shapes of the fixed validation set. With `--pod N` also
  PODChebyshev, fitted to N maps of the stream in the same run.
- `timing`: one map on a CPU, Table 1 of Wang et al., MIDL 2020: the surrogate by each backend, our exact engine, stock
  Warp, and libigl, from the four parameters to the values on the same grid, each checked against the exact maps first.
  On a GPU: batches, surrogate against exact.

Results go to bench/results/surrogate-DEVICE.json, each part beside those that are there already, and a table to stdout.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.surrogate.accuracy import accuracy
from sdm.bench.surrogate.timing import timing

PARTS = {"accuracy": accuracy, "timing": timing}
PACKAGES = ("warp-lang", "torch", "numpy", "libigl", "onnxruntime", "openvino")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=tuple(PARTS), default=list(PARTS))
    parser.add_argument(
        "--weights", nargs="*", type=Path, default=[], help="files of weights; the shipped ones if none"
    )
    parser.add_argument("--count", type=int, default=1000, help="shapes of the validation set")
    parser.add_argument("--pod", type=int, default=0, help="maps to fit PODChebyshev to; 0 leaves it out")
    parser.add_argument("--modes", type=int, default=256, help="modes of PODChebyshev")
    parser.add_argument("--degree", type=int, default=8, help="total degree of PODChebyshev")
    parser.add_argument("--budget-s", type=float, default=float("inf"), help="begin no further model after this")
    parser.add_argument("--runs", type=int, default=200, help="timed calls of each method, if the budget allows")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)), help="cores for the CPU's methods")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    kind = options.device.split(":")[0]
    out = options.out or results_folder() / f"surrogate-{kind}.json"
    report: dict[str, Any] = json.loads(out.read_text()) if out.is_file() else {}
    options.deadline = time.perf_counter() + options.budget_s
    for name in options.parts:
        report[name] = {"machine": describe(options.device, PACKAGES), **PARTS[name](options)}
        write(out, report)


if __name__ == "__main__":
    main()
