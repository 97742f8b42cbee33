"""Put a trained surrogate into the package: its weights, its description and its model card.

    python -m sdm.bench.surrogate.ship RUN/sdmnn-plus.safetensors --results bench/results/surrogate-cuda.json

The results are those of `python -m sdm.bench.surrogate --parts accuracy` for this very file, and of `python -m
sdm.bench.surrogate.worst`; the card states them.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sdm.bench.common.checkout import results_folder, within_checkout
from sdm.bench.common.json_file import put, write
from sdm.bench.surrogate.accuracy import COLUMNS
from sdm.io.files.atomic import replacing
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, Settings
from sdm.surrogate.infer.predict import WEIGHTS

LARGEST_MB = 8.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path, help="NAME.safetensors, with NAME.json beside it")
    parser.add_argument("--results", type=Path, default=results_folder() / "surrogate-cuda.json")
    parser.add_argument("--worst", type=Path, default=results_folder() / "surrogate-worst.json")
    parser.add_argument("--to", type=Path, default=WEIGHTS, help="folder of the package's weights")
    options = parser.parse_args()
    measured = json.loads(options.results.read_text())["accuracy"]
    row = measured["models"].get(options.weights.stem)
    if row is None:
        raise SystemExit(f"{options.results} says nothing of {options.weights.stem}: measure it first")
    facts = json.loads(options.weights.with_suffix(".json").read_text())
    if facts["family"] != Cochlea().fingerprint:
        raise SystemExit(f"{options.weights} was trained on another cochlea family: train it again")
    data = options.weights.read_bytes()
    if len(data) > 1e6 * LARGEST_MB:
        raise SystemExit(f"{options.weights} has {len(data) / 1e6:.1f} MB; at most {LARGEST_MB:g} are shipped")
    if row.get("training") != facts.get("training"):
        raise SystemExit(f"{options.results} is about another training than {options.weights}: measure this one")
    facts["errors"] = {
        key: row[key] for key in row if isinstance(row[key], float) and key not in ("seconds", "file_mb")
    }
    facts["validation"] = measured["validation"]
    search = json.loads(options.worst.read_text())
    if search["training"] != facts.get("training"):
        raise SystemExit(f"{options.worst} is about another training than {options.weights}: search its worst case")
    name = facts["model"]
    write(options.to / f"{name}.json", facts)
    put(options.to / "README.md", card(facts, len(data), measured["machine"], options.results, search))
    with replacing(options.to / f"{name}.safetensors") as part:
        part.write_bytes(data)
    print(f"{options.to / name}.safetensors, {len(data) / 1e6:.2f} MB")


def card(facts: dict[str, Any], size: int, machine: dict[str, Any], results: Path, search: dict[str, Any]) -> str:
    """The model card."""
    errors, training = facts["errors"], facts["training"]
    box = "\n".join(f"| {name} | {low:g} | {high:g} | {unit} |" for name, low, high, unit in facts["parameters"])
    chain = [training]
    while "started_from" in (last := facts if len(chain) == 1 else chain[-1]):
        chain.append(last["started_from"])
    before = "".join(f"It went on from weights of {made_by(one)}.\n" for one in chain[1:])
    saw = [one for one in chain if one["recipe"] == "mostly-online"]
    corners = "which no training saw"
    if saw:
        steps = f"{sum(one['step'] for one in saw):,} of {sum(one['step'] for one in chain):,} steps"
        corners = f"which were 3 in 100 samples of the first {steps}" if saw != chain else "3 in 100 training samples"
    worst = search["worst"][0]
    place = ", ".join(f"{name} = {value:g}" for name, value in worst["theta"].items())
    source = within_checkout(results)
    lines = "\n".join(f"| {label} | {errors[key]:.4f} |" for key, label in COLUMNS.items())
    return f"""# Model card: {facts["model"]}

From four shape parameters of `sdm.shapes.Cochlea` to its signed distance map: {" x ".join(map(str, GRID.shape))}
voxels of {GRID.spacing[0]:g} mm, negative inside, millimetres. {size / 1e6:.2f} MB. Licence: that of this package.

## For what, and for what not

For quick maps of this family of model shapes on a CPU, for example inside a fit. It knows nothing of cochleae outside
the family or its box of parameters, and is no medical device. Where the last hundredth of a millimetre matters, use
the exact engine (`sdm predict --exact`), which the surrogate imitates.

| parameter | lowest | highest | unit |
| --- | ---: | ---: | --- |
{box}

## Errors

On the fixed validation set `{facts["validation"]}` (984 uniform shapes that no training has, and
the 16 corners of the box, {corners}), against exact maps; lengths in mm, "near" is within 0.5 mm
of the surface. Means over shapes; "max" and "worst" over all. Between these shapes errors may be larger: the worst Dice
that a search of the box found, among {search["shapes"]:,} shapes, is {worst["dice"]:.4f}, at {place}
(`python -m sdm.bench.surrogate.worst`). Voxels on the surface, as on the flat base of every shape, count as outside.
The surface's distances are read from voxels: exact maps themselves have not quite zero there (`{source}`).

| measure | value |
| --- | ---: |
{lines}

Measured by `python -m sdm.bench.surrogate --parts accuracy` on: {machine["device"]}, commit {machine["commit"]}.

## Training

{made_by(training)}.
{before}All maps were made by the exact engine during the training (seed {training["seed"]}). Data: synthetic alone; the
family's constants were tuned to the mean of 15 real human scalae tympani (Froehlich 2024, CC BY 4.0).
"""


def made_by(training: dict[str, Any]) -> str:
    """The command of a training, and what it took."""
    # What a command would have to say; all else is as it comes.
    usual = asdict(Settings())
    asked = {key: value for key, value in training.items() if key in usual and value not in (None, usual[key])}
    names = {"rate": "learning-rate"}
    options = [
        f"--{names.get(key, key).replace('_', '-')}" + ("" if value is True else f" {value}")
        for key, value in asked.items()
    ]
    return (
        f"`sdm train sdmnn {' '.join(options)}`, {training['step']:,} steps of {training['batch_size']} maps in "
        f"{training['seconds']:g} s"
    )


if __name__ == "__main__":
    main()
