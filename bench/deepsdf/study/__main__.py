"""DeepSDF on left atria at equal code sizes: rates searched for each method, all of the paper's measures, baselines.

    python -m sdm.bench.deepsdf.study run --data DATA --budget-s 240     # goes on where it was; all GPUs
    python -m sdm.bench.deepsdf.study table                              # the tables from the logs
    python -m sdm.bench.deepsdf.study table --page bench/results/deepsdf_study.md
    python -m sdm.bench.deepsdf.study plot                               # docs/deepsdf-study.png

The shapes are split by `sdm.bench.deepsdf.study.atria_split`: near twins are on one side. Each method is trained by
one seed at each of the same three rates; the rate whose codes are nearest to the validation shapes is trained by the
other seeds too, and only those networks see the test shapes. All trainings have as many steps and samples.
Representation: codes from exact samples of the whole shape. Completion: codes from points of one half of the surface,
with normals. Baselines: a copy of the nearest training shape as it is, or laid on what was seen, and maps of as many
exact distances as a code has numbers, enlarged cubically.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from sdm.bench.common.checkout import data_folder, docs_folder, results_folder
from sdm.bench.common.json_file import put
from sdm.bench.deepsdf.shapes import atria
from sdm.bench.deepsdf.study.jobs import METHODS, work
from sdm.bench.deepsdf.study.study_tables import page, picture, tables
from sdm.bench.segmentation.gpu_jobs import devices, run_jobs
from sdm.bench.segmentation.log_file import Job, LogFile, log_file

LOGS = LogFile(results_folder() / "deepsdf_study.jsonl")
RATES = (5e-4, 1.5e-3, 4.5e-3)
BATCH, POINTS = 32, 1024


def main() -> None:
    options = parser().parse_args()
    if options.what == "run":
        on = devices(options.gpus) * options.per_gpu
        # Surfaces are made once, before several processes want them.
        atria(options.data, cache=options.cache)
        task = partial(work, logs=options.logs)
        run_jobs(jobs(options), task, options.logs, options.work, budget_s=options.budget_s, on=on)
    if options.what == "plot":
        picture(options.logs, options.out)
    if options.page:
        put(options.page, page(options.logs))
    print(tables(options.logs))


def jobs(options: argparse.Namespace) -> list[Job]:
    """The search for the rates, the baselines, then all methods with the first seed, all with the next."""
    common = {
        "data": str(options.data),
        "cache": str(options.cache),
        **{name: getattr(options, name) for name in ("steps", "batch", "points", "search_steps", "few", "resolution")},
        "compile": options.compile,
    }
    first = options.seeds[0]
    found: list[Job] = [
        {"name": f"{method}-rate-{rate:g}", "kind": "rate", "method": method, "rate": rate, "seed": first, **common}
        for method in options.methods
        for rate in options.rates
    ]
    if options.baselines:
        found.append({"name": "baselines", "kind": "baselines", **common})
    found += [
        {"name": f"{method}-{seed}", "kind": "test", "method": method, "rates": options.rates, "seed": seed, **common}
        for seed in options.seeds
        for method in options.methods
    ]
    return found


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "table", "plot"))
    parser.add_argument("--data", type=Path, default=data_folder(), help="data folder, or the packed file")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/sdm-atria.pt"), help="keeps the atria's surfaces")
    parser.add_argument("--logs", type=log_file, default=LOGS)
    parser.add_argument("--work", type=Path, default=Path("/tmp/sdm-deepsdf-study"), help="networks")
    parser.add_argument("--out", type=Path, default=docs_folder() / "deepsdf-study.png")
    parser.add_argument("--page", type=Path, help="Markdown file for the tables and what was done")
    parser.add_argument("--budget-s", type=float, default=3600.0)
    parser.add_argument("--gpus", type=int, default=None, help="default: all")
    parser.add_argument("--per-gpu", type=int, default=1, help="processes on each")
    parser.add_argument("--methods", nargs="*", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--batch-size", dest="batch", type=int, default=BATCH)
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--search-steps", type=int, default=300)
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--few", type=int, default=None, help="only so many shapes of each part, to see that it works")
    parser.add_argument("--no-baselines", dest="baselines", action="store_false")
    parser.add_argument("--no-compile", dest="compile", action="store_false")
    return parser


if __name__ == "__main__":
    main()
