"""Studies of DeepSDF: train, evaluate, compare. Each command goes on where it was cut off.

    python -m sdm.bench.deepsdf train atria --variant local --budget-s 120 --out runs/atria-local
    python -m sdm.bench.deepsdf evaluate atria --out runs/atria-local [--parts search unseen known ...]
    python -m sdm.bench.deepsdf recipe cochlea --count 100 --epochs 1000 --seeds 2 --out runs/cochlea-recipe
    python -m sdm.bench.deepsdf scale atria --out runs/atria-local
    python -m sdm.bench.deepsdf fit cochlea --out runs/cochlea-local
    python -m sdm.bench.deepsdf report runs/* --to bench/results

- `train`: the cochlea family (500 shapes) or left atria (72 labels) on exact samples, or on approximate ones.
- `evaluate`: `search` finds the codes of unseen shapes, of half of their surface and of noisy points, by maximum a
  posteriori estimation, into `codes.pt`, which another machine may score; then known and unseen shapes, completion,
  times, and a strip of pictures from one code to another. `scores.json` grows part by part.
- `recipe`: exact samples against DeepSDF's approximate recipe: one network, as many steps, the same shapes; how wrong
  the recipe's samples are, and what that costs.
- `scale`: the paper's scale for scores that are older than it.
- `fit`: a cochlea's map and the fit of one to a label, beside the mesh.
- `report`: a table (`deepsdf.md`) and all figures (`deepsdf.json`) of some runs.

Atria come from the data folder (--data, $SDM_DATA, else ../shared/data), or from a file that sdm.bench.deepsdf.shapes
packed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe, device_name
from sdm.bench.deepsdf import beside_surrogate as fitting
from sdm.bench.deepsdf import evaluate as evaluation
from sdm.bench.deepsdf.approximate_samples import ApproximateSamples, Quality
from sdm.bench.deepsdf.cameras import Cameras
from sdm.bench.deepsdf.paper_scale import in_paper_scale
from sdm.bench.deepsdf.report import report
from sdm.bench.deepsdf.shapes import Shapes, atria, cochleas
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, interpolation_strip, render, save_picture, train
from sdm.deepsdf.samples import SampleSource, ShapeSet
from sdm.deepsdf.train.process_group import process_group
from sdm.deepsdf.train.settings import VARIANTS, Settings
from sdm.io.files.torch_file import save_torch
from sdm.shapes import Cochlea

PARTS = ("search", "speed", "pictures", "unseen", "known", "half", "noisy")


def main() -> None:
    options = arguments()
    if options.command == "report":
        report(options.runs, options.to)
        return
    commands = {
        "train": run_train,
        "evaluate": run_evaluate,
        "recipe": run_recipe,
        "scale": run_scale,
        "fit": run_fit,
    }
    commands[options.command](options)


def run_train(options: argparse.Namespace) -> None:
    with process_group(options.device) as device:
        shapes = ShapeSet(of_class(options).training, device)
        source: SampleSource = shapes
        if options.samples == "approximate":
            source = approximate_of(shapes, options)
        trained(source, shapes, settings_of(options), options.out, options)


def trained(source: SampleSource, shapes: ShapeSet, settings: Settings, out: Path, options: argparse.Namespace) -> Path:
    start = time.monotonic()

    def say(step: int, steps: int, loss: float) -> None:
        if step % 500 == 0 or step == steps:
            print(f"{out.name}: step {step}, loss {loss:.5f}, {time.monotonic() - start:.0f} s", flush=True)

    return train(
        source,
        settings,
        out,
        names=shapes.names,
        spheres=shapes.spheres,
        budget_s=options.budget_s,
        device=shapes.device,
        resume=True,
        compile_network=None if options.compile else False,
        progress=say,
    )


def run_evaluate(options: argparse.Namespace) -> None:
    model = DeepSDF.load(options.out, options.device)
    shapes = of_class(options)
    resolution = options.resolution

    def searched(name: str) -> evaluation.Found:
        return evaluation.Found(*torch.load(options.out / "codes.pt", map_location=model.device)[name])

    parts: dict[str, Callable[[], Any]] = {
        "search": lambda: search(model, shapes.test, options),
        "speed": lambda: evaluation.speed(model, shapes.test[0]),
        "pictures": lambda: pictures(model, options.out, options.size),
        "unseen": lambda: evaluation.unseen(model, shapes.test, searched("unseen"), resolution),
        "known": lambda: evaluation.known(model, shapes.training, options.known, resolution),
        "half": lambda: evaluation.completion(model, shapes.test, searched("half"), resolution),
        "noisy": lambda: evaluation.completion(model, shapes.test, searched("noisy"), resolution),
    }
    chosen = {name: parts[name] for name in parts if name in options.parts}
    about = {"class": options.shapes, "settings": model.settings.record(), "training": training_of(options.out)}
    in_turn(chosen, options, about, options.budget_s)


def search(model: DeepSDF, test: list[TriangleMesh], options: argparse.Namespace) -> dict[str, Any]:
    """Codes into `codes.pt`, so that another machine may score them; their times into the figures."""
    compiled = options.compile and model.device.type == "cuda"
    found = evaluation.search(model, test, options.steps, options.prior, compiled, options.search)
    target = options.out / "codes.pt"
    known = torch.load(target, map_location="cpu") if target.exists() else {}
    save_torch(known | {name: tuple(each) for name, each in found.items()}, target)
    seconds = {name: each.seconds_a_shape for name, each in found.items()}
    return {"device": device_name(str(model.device)), "shapes": len(test), "prior": options.prior, "seconds": seconds}


def run_fit(options: argparse.Namespace) -> None:
    model, family = DeepSDF.load(options.out, options.device), Cochlea(options.triangles)
    parts: dict[str, Callable[[], Any]] = {
        "maps": lambda: fitting.whole_maps(model, family),
        "fits": lambda: fitting.fits(model, family, options.test or 3, options.fit_steps),
    }
    in_turn(parts, options, {}, options.budget_s)


def run_recipe(options: argparse.Namespace) -> None:
    shapes = of_class(options)
    found = ShapeSet(shapes.training, options.device)
    settings = settings_of(options)
    table = approximate_of(found, options)
    sources: dict[str, SampleSource] = {"exact": found, "approximate": table}

    def study(name: str, seed: int) -> dict[str, Any]:
        out = options.out / f"{name}-{seed}"
        path = trained(sources[name], found, replace(settings, seed=seed), out, options)
        model = DeepSDF.load(path, options.device)
        codes = evaluation.search(model, shapes.test, options.steps, None, False, ("unseen",))["unseen"]
        return {
            "samples": name,
            "seed": seed,
            "training": training_of(out),
            "known": evaluation.known(model, shapes.training, options.known, options.resolution),
            "unseen": evaluation.unseen(model, shapes.test, codes, options.resolution),
        }

    cameras = asdict(cameras_of(options))
    parts: dict[str, Callable[[], Any]] = {
        "recipe": lambda: {"samples": options.table, **cameras, **asdict(Quality.mean(table.qualities))}
    }
    for seed in range(options.seeds):
        parts |= {f"{name} {seed}": partial(study, name, seed) for name in sources}
    in_turn(parts, options, {"class": options.shapes, "settings": settings.record(), "shapes": len(found)}, None)


def approximate_of(shapes: ShapeSet, options: argparse.Namespace) -> ApproximateSamples:
    return ApproximateSamples(shapes, options.table, cameras_of(options), options.out / "tables")


def cameras_of(options: argparse.Namespace) -> Cameras:
    return Cameras(options.views, options.pixels)


def run_scale(options: argparse.Namespace) -> None:
    path, shapes = options.out / "scores.json", of_class(options)
    result = json.loads(path.read_text())
    for name, truths in (("known", shapes.training), ("unseen", shapes.test)):
        if name in result:
            result[name] = in_paper_scale(result[name], truths)
            print(json.dumps({name: {k: result[name][k] for k in ("mean", "median")}}, indent=1))
    write(path, result)


def in_turn(
    parts: dict[str, Callable[[], Any]],
    options: argparse.Namespace,
    about: dict[str, Any],
    budget_s: float | None,
) -> None:
    """Each part that `scores.json` does not have yet, until the budget is over."""
    path, start = options.out / "scores.json", time.monotonic()
    result = json.loads(path.read_text()) if path.exists() else {}
    device = options.device if options.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    result |= {"machine": describe(device), **about}
    # Parts may come from several machines.
    where = f"{result['machine']['device']}, commit {result['machine']['commit']}"
    for name, part in parts.items():
        if name in result and not options.again:
            continue
        if budget_s is not None and time.monotonic() - start > budget_s:
            print(f"{name} is left for the next time: the budget is over")
            continue
        result[name] = part()
        result.setdefault("measured_on", {})[name] = where
        short = {k: v for k, v in result[name].items() if k != "rows"} if isinstance(result[name], dict) else None
        print(json.dumps({name: short}, indent=1)[:4000], f"\n{time.monotonic() - start:.1f} s", flush=True)
        write(path, result)


def pictures(model: DeepSDF, out: Path, size: int) -> dict[str, Any]:
    """A strip from the first training shape to the last, and the first one alone, by sphere tracing."""
    start = time.perf_counter()
    save_picture(interpolation_strip(model, model.codes[0], model.codes[-1], size=size), out / "interpolation.png")
    strip = time.perf_counter() - start
    save_picture(render(model, model.codes[0], size=2 * size), out / "first.png")
    return {"files": ["interpolation.png", "first.png"], "seconds_strip_of_7": strip, "size": size}


def of_class(options: argparse.Namespace) -> Shapes:
    if options.shapes == "cochlea":
        return cochleas(options.count or 500, options.test or 8, triangles=options.triangles)
    return atria(options.data, options.count, options.test, cache=options.cache)


def settings_of(options: argparse.Namespace) -> Settings:
    changes = {name: getattr(options, name) for name in ("width", "layers", "points", "batch", "precision", "epochs")}
    changes = {("shapes" if k == "batch" else k): v for k, v in changes.items() if v is not None}
    if options.variant == "local" and options.shapes == "cochlea":
        # Four parameters make the family: a code of the whole shape is enough, and the model stays small.
        changes = {"grids": (), "global_size": 32, "width": 256, "layers": 6, "code_weight": 1e-5} | changes
    return VARIANTS[options.variant](**changes)


def training_of(folder: Path) -> dict[str, Any]:
    saved = torch.load(folder / "model.pt", map_location="cpu", weights_only=True)
    last = [loss for _, _, loss in saved["history"][-20:]]
    size = (folder / "model.pt").stat().st_size / 2**20
    return {
        "shapes": len(saved["names"]),
        "steps": saved["step"],
        "seconds": saved["seconds"],
        "last_loss": sum(last) / max(len(last), 1),
        "model_mib": size,
    }


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("train", "evaluate", "recipe", "scale", "fit"):
        command = commands.add_parser(name)
        command.add_argument("shapes", choices=("cochlea", "atria"))
        command.add_argument("--out", type=Path, required=True, help="folder of the run")
        command.add_argument("--data", type=Path, default=data_folder())
        command.add_argument("--cache", type=Path, help="file that keeps the surfaces of the atria")
        command.add_argument("--device", default="auto")
        command.add_argument("--budget-s", type=float, help="seconds of training, or after which no part begins")
        command.add_argument("--count", type=int, help="training shapes")
        command.add_argument("--test", type=int, help="test shapes")
        command.add_argument("--triangles", type=int, default=6_000, help="of a cochlea")
        command.add_argument("--no-compile", dest="compile", action="store_false")
        command.add_argument("--variant", choices=tuple(VARIANTS), default="local")
        for option in ("width", "layers", "points", "batch", "epochs"):
            command.add_argument(f"--{option}", type=int)
        command.add_argument("--precision", choices=("bf16", "tf32", "float32"))
        command.add_argument("--samples", choices=("exact", "approximate"), default="exact")
        command.add_argument("--table", type=int, default=500_000, help="approximate samples of a shape")
        command.add_argument("--views", type=int, default=Cameras.views, help="cameras of the approximate recipe")
        command.add_argument("--pixels", type=int, default=Cameras.pixels, help="along an image of such a camera")
        command.add_argument("--seeds", type=int, default=1, help="trainings of each kind in a study of the recipe")
        command.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
        searches = evaluation.SEARCHES
        command.add_argument("--search", nargs="+", choices=searches, default=searches, help="from what, for search")
        command.add_argument("--again", action="store_true", help="parts that are there, too")
        command.add_argument("--known", type=int, default=16, help="known shapes to score")
        command.add_argument("--steps", type=int, default=800, help="of the search for a code")
        command.add_argument("--fit-steps", type=int, default=fitting.STEPS)
        command.add_argument("--prior", type=float, help="weight of a code's length in completion")
        command.add_argument("--resolution", type=int, default=256)
        command.add_argument("--size", type=int, default=192, help="pixels of a picture")
    command = commands.add_parser("report")
    command.add_argument("runs", nargs="+", type=Path)
    command.add_argument("--to", type=Path, default=results_folder())
    return parser.parse_args()


if __name__ == "__main__":
    main()
