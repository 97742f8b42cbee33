"""Damaged files of narrow bands: the band that was written, or one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import sdm
from sdm.bench.common.mesh_formulas import sphere
from sdm.bench.fuzz.damage import drawn
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.io import load_band

ENDINGS = ("npz", "zarr", "nvdb")


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """One band in one format with one kind of damage."""
    vertices, faces = sphere(6)
    mesh = sdm.TriangleMesh(vertices * rng.uniform(0.5, 2, 3).astype(np.float32), faces)
    band = sdm.narrow_band(mesh, resolution=int(rng.integers(9, 25)), half_width=2.0)
    ending = ENDINGS[rng.integers(len(ENDINGS))]
    path = folder / f"band.{ending}"
    with one_sentence(f"{ending} write") as refused:
        band.save(path)
        whole = load_band(path)
    if refused:
        raise Finding(f"{ending}: a band is refused as it is written or read")
    name, damage = drawn(rng)
    parts = sorted(part for part in path.rglob("*") if part.is_file()) if path.is_dir() else [path]
    part = parts[rng.integers(len(parts))]
    part.write_bytes(damage(part.read_bytes(), rng))
    label = f"{ending} {name}"
    with one_sentence(label) as outcome:
        found = load_band(path)
        same = torch.equal(found.blocks, whole.blocks) and torch.equal(found.values, whole.values)
        if not same:
            raise Finding(f"{label}: read as another band, without a word")
    return outcome[0] if outcome else Outcome(label, refused=False)
