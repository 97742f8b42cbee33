"""Damaged files of maps: the map that was written, or one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import sdm
from sdm.bench.fuzz.damage import drawn
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.io import FORMATS

# An image whose header has another grid than our record is one that another program turned, cropped or moved.
MOVABLE = ("nii", "nii.gz", "nrrd", "mha", "mhd", "vti")


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """One map in one format with one kind of damage."""
    shape = tuple(int(n) for n in rng.integers(2, 9, 3))
    grid = sdm.Grid(rng.normal(size=3), rng.uniform(0.1, 2, 3), shape)
    field = sdm.SDM(torch.from_numpy(rng.normal(size=shape).astype(np.float32)), grid)
    ending = list(FORMATS)[rng.integers(len(FORMATS))]
    path = folder / f"map.{ending}"
    with one_sentence(f"{ending} write") as refused:
        field.save(path)
        whole = sdm.load(path)
    if refused:
        raise Finding(f"{ending}: a map of shape {shape} is refused as it is written or read")
    name, damage = drawn(rng)
    parts = [part for part in path.rglob("*") if part.is_file()] if path.is_dir() else [path]
    part = sorted(parts)[rng.integers(len(parts))]
    part.write_bytes(damage(part.read_bytes(), rng))
    label = f"{ending} {name}"
    with one_sentence(label) as outcome:
        found = sdm.load(path)
        same = found.grid == whole.grid and torch.equal(found.values, whole.values)
        moved = ending in MOVABLE and found.grid != whole.grid
        if not (same or moved):
            raise Finding(f"{label}: read as another map, without a word")
    return outcome[0] if outcome else Outcome(label, refused=False)
