"""Many meshes: how long do ten million take, by a simulation of the pipeline from measured stage times?

    python -m sdm.bench.disk.simulate --files 20000 --resolution 8

First `sdm compute` goes through so many small files, each stage of each mesh timed. Then the pipeline is simulated with
times drawn from one mesh in twenty of that run, at the same number of meshes, which is the check, and at 1,000 to
100,000. `--stages RECORD` takes a row of a record of `python -m sdm.bench.disk` instead, and nothing is run.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.disk.pipelines import small_run, together_on
from sdm.bench.disk.queues import Draw, Pipeline
from sdm.runtime.pipeline.thread_count import readers_beside, threads_beside, writers_beside

COUNTS = (1_000, 10_000, 100_000)
# The job whose cost is told.
OBJAVERSE, GPUS = 10_000_000, 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--resolution", type=int, default=8)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--folder", type=Path, help="a place on the disk that counts")
    parser.add_argument("--stages", type=Path, metavar="RECORD", help="a record of python -m sdm.bench.disk")
    parser.add_argument("--work", default="compute .npz", help="with --stages, the row")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    if options.stages is not None:
        record = from_record(json.loads(options.stages.read_text()), options.work)
    else:
        folder = Path(tempfile.mkdtemp(prefix="sdm-many-", dir=options.folder))
        try:
            record = from_run(folder, options.files, options.resolution, options.device)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    print(json.dumps(record, indent=1))
    if options.out is not None:
        json_file.write(options.out, record)


def from_run(folder: Path, files: int, resolution: int, device: str) -> dict[str, Any]:
    """Measure a run over small files, and simulate it."""
    where = torch.device(device)
    seconds, times = small_run(folder, files, resolution, device)
    spans = {stage: [span for span in times.spans if span.stage == stage] for stage in times.seconds}
    together = together_on(where)
    drawn = [_resampled([span.end - span.begin for span in spans[stage]][::20]) for stage in ("read", device, "write")]
    model = Pipeline(
        readers=readers_beside(where),
        writers=writers_beside(where),
        together=together,
        read=drawn[0],
        measure=drawn[1],
        write=drawn[2],
    )
    simulated = model.seconds(files)
    return {
        "machine": describe(device),
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "files": files,
        "resolution": resolution,
        "measured_seconds": round(seconds, 2),
        "simulated_seconds": round(simulated, 2),
        "simulated_over_measured": round(simulated / seconds, 3),
        "busy_ms_each": {stage: round(1e3 * busy / files, 3) for stage, busy in times.seconds.items()},
        **costs(model),
    }


def from_record(record: dict[str, Any], work: str) -> dict[str, Any]:
    """Simulate a row of a record of `python -m sdm.bench.disk`, each mesh with the mean times."""
    rows = {row["work"]: row for row in record["pipelines"]}
    if work not in rows:
        raise SystemExit(f"the record has no row {work!r}, but {', '.join(rows)}")
    row = rows[work]
    device = next(stage for stage in row["busy_seconds"] if stage not in ("read", "write"))
    where = torch.device(device)
    compute, cores = work.startswith("compute"), record["cores"]
    together = together_on(where) if compute else 1
    each = {stage: busy / row["count"] for stage, busy in row["busy_seconds"].items()}
    model = Pipeline(
        readers=readers_beside(where, cores) if compute else threads_beside(where, cores),
        writers=writers_beside(where, cores) if compute else threads_beside(where, cores),
        together=together,
        read=_constant(each.get("read", 0.0)),
        measure=_constant(each[device] * together),
        write=_constant(each["write"]),
    )
    return {
        "work": work,
        "machine": record["machine"],
        "measured_seconds": round(row["count"] / row["per_second"], 2),
        "simulated_seconds": round(model.seconds(row["count"]), 2),
        **costs(model),
    }


def costs(model: Pipeline) -> dict[str, Any]:
    """Simulated rates by the number of meshes, and the hours of the large job, in equal shards on each GPU."""
    rates = {count: count / model.seconds(count) for count in COUNTS}
    return {
        "simulated_per_second": {str(count): round(rate, 1) for count, rate in rates.items()},
        f"hours_of_{OBJAVERSE}_on_{GPUS}": round(OBJAVERSE / GPUS / rates[COUNTS[-1]] / 3600, 2),
    }


def _resampled(seconds: list[float]) -> Draw:
    generator = np.random.default_rng(0)
    return lambda count: generator.choice(np.asarray(seconds), count)


def _constant(seconds: float) -> Draw:
    return lambda count: np.full(count, seconds)


if __name__ == "__main__":
    main()
