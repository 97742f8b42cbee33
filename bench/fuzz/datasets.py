"""Damaged datasets: the samples that were written, or one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import sdm
from sdm.bench.fuzz.damage import drawn
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.dataset import SDMDataset, generate

COUNT = 3


def _places(node: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of the values of a JSON document."""
    inner = list(node.items()) if isinstance(node, dict) else list(enumerate(node)) if isinstance(node, list) else []
    return [at, *(place for key, value in inner for place in _places(value, (*at, key)))]


def _edit(manifest: Path, rng: np.random.Generator) -> str:
    """Remove or replace one value of the manifest."""
    document = json.loads(manifest.read_text())
    places = [place for place in _places(document) if place and place[0] == "attributes"]
    *way, last = places[rng.integers(len(places))]
    node = document
    for key in way:
        node = node[key]
    if rng.random() < 0.5:
        del node[last]
    else:
        node[last] = [None, -1, "x", [], {}, 10**12, 0.5, True][rng.integers(8)]
    manifest.write_text(json.dumps(document))
    return ".".join(map(str, (*way, last)))


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """A small dataset with an edit of its manifest, or damage to one of its files."""
    family = sdm.shapes.Ellipsoid()
    path = folder / "data.zarr"
    generate(family, family.grid(8), COUNT, path, seed=int(rng.integers(1 << 30)), shard=2, device="cpu")
    whole = [SDMDataset(path)[i] for i in range(COUNT)]
    if rng.random() < 0.5:
        label = f"manifest {_edit(path / 'zarr.json', rng)}"
    else:
        files = sorted(part for part in path.rglob("*") if part.is_file())
        part = files[rng.integers(len(files))]
        name, damage = drawn(rng)
        part.write_bytes(damage(part.read_bytes(), rng))
        label = f"file {part.relative_to(path).parts[0]} {name}"
    with one_sentence(label) as outcome:
        data = SDMDataset(path)
        if len(data) == COUNT:
            for sample, one in zip(whole, (data[i] for i in range(COUNT)), strict=True):
                if not all(np.array_equal(a, b) for a, b in zip(sample, one, strict=True)):
                    raise Finding(f"{label}: another sample, without a word")
    return outcome[0] if outcome else Outcome(label.split()[0], refused=False)
