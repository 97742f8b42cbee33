"""Jobs of the DeepSDF study: the search for a rate, a network and its test shapes, and the baselines."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.machine import describe
from sdm.bench.deepsdf import evaluate as evaluation
from sdm.bench.deepsdf.shapes import atria
from sdm.bench.deepsdf.study.atria_split import read_record, split_atria
from sdm.bench.deepsdf.study.baselines import coarse_map, nearest_copy
from sdm.bench.deepsdf.study.scores import half_scores, halves, scores, whole_scores
from sdm.bench.segmentation.log_file import Job, Log, LogFile
from sdm.bench.studies.rate_search import best_rate
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, Settings, local, published, train
from sdm.deepsdf.samples import ShapeSet, UnitSphere
from sdm.sampling.near_twins import Surface

# Numbers of a code: 256, 256, 14,912.
METHODS = {
    "published": published(),
    "local-256": local(global_size=64, grids=((4, 3),)),
    "local": local(),
}
# Voxels along an axis of maps with about as many numbers as the codes.
MAPS = (6, 24)
KNOWN = 4
# Samples of each shape in a step of the search for its code.
SEARCHED = 4000


def work(
    job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float, *, logs: LogFile
) -> Log | None:
    """One job of the study; None where the deadline came first."""
    if "parts" not in kept:
        shapes = atria(Path(job["data"]), cache=Path(job["cache"]))
        parts = split_atria(shapes, read_record())
        kept["parts"] = {name: own[: job["few"]] for name, own in parts.items()}
    begin = time.monotonic()
    if job["kind"] == "baselines":
        found: Log | None = baselines(kept["parts"], job, device)
    elif job["kind"] == "rate":
        found = rate_job(job, device, unfinished, kept, deadline)
    else:
        rate = best_rate(partial(rates_of, logs, job["method"]), job["rates"], deadline)
        found = None if rate is None else test_job({**job, "rate": rate}, device, unfinished, kept, deadline)
    if found is None:
        return None
    machine = describe(device, ("torch", "warp-lang", "scipy"))
    return {"whole_s": round(time.monotonic() - begin, 1), "machine": machine, **found}


def settings_of(job: Job) -> Settings:
    """Settings of a training: a method's own, but for the rates, the steps and the samples of a step."""
    usual = METHODS[job["method"]]
    return replace(
        usual,
        decoder_rate=job["rate"],
        code_rate=job["rate"] * usual.code_rate / usual.decoder_rate,
        shapes=job["batch"],
        points=job["points"],
        # Of 55 shapes and batches of 32 an epoch is one step.
        epochs=job["steps"],
        seed=job["seed"],
    )


def trained(job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float) -> DeepSDF | None:
    """The network of a job, trained now, before, or to its end; None where the deadline came first."""
    if "set" not in kept:
        kept["set"] = ShapeSet(kept["parts"]["training"], device)
    shapes: ShapeSet = kept["set"]
    folder = unfinished / f"{job['method']}-{job['rate']:g}-{job['seed']}"

    def look(step: int, steps: int, loss: float) -> None:
        if time.monotonic() > deadline and step < steps:
            raise TimeoutError

    try:
        path = train(
            shapes,
            settings_of(job),
            folder,
            names=shapes.names,
            spheres=shapes.spheres,
            device=device,
            resume=True,
            checkpoint_every_s=20.0,
            compile_network=job["compile"],
            progress=look,
        )
    except TimeoutError:
        return None
    return DeepSDF.load(path, device)


def rate_job(job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float) -> Log | None:
    """Distance of a network trained at some rate from the validation shapes."""
    model = trained(job, device, unfinished, kept, deadline)
    if model is None:
        return None
    parts, steps = kept["parts"], job["search_steps"]
    codes = evaluation.search(model, parts["validation"], steps, None, False, ("unseen",), SEARCHED)["unseen"].codes
    rows = dict(whole_scores(model, codes, parts["validation"], job["resolution"]))
    mean = sum(row["mean_mm"] for row in rows.values()) / len(rows)
    return {"summary": f"{mean:.3f} mm", "rate": job["rate"], "validation_mm": mean, "validation": rows,
            "training": training_of(unfinished, job)}  # fmt: skip


def rates_of(logs: LogFile, method: str) -> dict[float, float]:
    """Rate -> mean distance from the validation shapes in mm, of those tried."""
    own = [log for log in logs.trainings() if log["job"]["kind"] == "rate" and log["job"]["method"] == method]
    return {log["job"]["rate"]: log["validation_mm"] for log in own}


def test_job(job: Job, device: str, unfinished: Path, kept: dict[str, Any], deadline: float) -> Log | None:
    """Test shapes from all of their surface and from half of it, and known shapes by the training's codes."""
    model = trained(job, device, unfinished, kept, deadline)
    if model is None:
        return None
    parts, resolution = kept["parts"], job["resolution"]
    test, few = parts["test"], parts["training"][:KNOWN]
    found = evaluation.search(model, test, job["search_steps"], None, False, ("unseen", "half"), SEARCHED)
    known = dict(whole_scores(model, model.codes[: len(few)], few, resolution))
    unseen = dict(whole_scores(model, found["unseen"].codes, test, resolution))
    half = dict(half_scores(model, found["half"].codes, test, resolution))
    mean = sum(row["mean_mm"] for row in unseen.values()) / len(unseen)
    seconds = {name: each.seconds_a_shape for name, each in found.items()}
    return {"summary": f"{mean:.3f} mm at {job['rate']:g}", "rate": job["rate"], "search_s_a_shape": seconds,
            "training": training_of(unfinished, job), "known": known, "unseen": unseen, "half": half}  # fmt: skip


def training_of(unfinished: Path, job: Job) -> dict[str, Any]:
    """Steps and seconds of a training, of which several may have shared a GPU."""
    path = unfinished / f"{job['method']}-{job['rate']:g}-{job['seed']}" / "model.pt"
    saved = torch.load(path, map_location="cpu", weights_only=True)
    return {"steps": saved["step"], "seconds": saved["seconds"], "settings": saved["settings"]}


def baselines(parts: dict[str, list[TriangleMesh]], job: Job, device: str) -> Log:
    """The trivial answers for the test shapes: representation and completion."""
    training = [Surface(UnitSphere.of(m).normalised(m), device) for m in parts["training"]]
    truths = [UnitSphere.of(m).normalised(m).to(device) for m in parts["test"]]
    points, _ = evaluation.scans(truths)
    seen = evaluation.seen_half(points)
    found: Log = {"unseen": {}, "half": {}, "copies": {}}
    for truth, mesh, at, half in zip(truths, parts["test"], points, seen, strict=True):
        shape, radius = Surface(truth, device), UnitSphere.of(mesh).radius
        for name, laid in (("copy", False), ("copy-laid", True)):
            whole = nearest_copy(shape, training, laid=laid)
            part = nearest_copy(shape, training, seen=at[half], laid=laid)
            names = [training[copy.number].index.mesh.name for copy in (whole, part)]
            found["copies"].setdefault(name, {})[mesh.name] = names
            found["unseen"].setdefault(name, {})[mesh.name] = scores(whole.mesh, truth, radius)
            row = scores(part.mesh, truth, radius) | halves(part.mesh, at, half, radius)
            found["half"].setdefault(name, {})[mesh.name] = row
        for size in MAPS:
            row = scores(coarse_map(truth, size), truth, radius)
            found["unseen"].setdefault(f"map-{size}", {})[mesh.name] = row
    return {"summary": f"{len(truths)} shapes", **found}
