"""Damaged or foreign files given as models: one sentence."""

from __future__ import annotations

import functools
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.fuzz.damage import drawn
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.deepsdf import DeepSDF
from sdm.segmentation import Settings, TrainedModel, load_model, save_model

KEYS = ("format", "settings", "weights", "model", "codes", "state")


@functools.cache
def _whole() -> bytes:
    """The bytes of a small segmentation model."""
    import tempfile

    settings = Settings(architecture="unet", patch=(16, 16, 16), filters=2, steps=1, batch=1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.pt"
        save_model(TrainedModel(settings.network(), settings, (1.0, 1.0, 1.0)), path)
        return path.read_bytes()


def _foreign(rng: np.random.Generator, path: Path) -> str:
    """A file that torch reads, but no model."""
    strange: list[Any] = [None, 1, "x", [], {}, torch.zeros(3), b"x", {"a": 1}]
    if rng.random() < 0.2:
        path.write_bytes(pickle.dumps(strange[rng.integers(len(strange))]))
        return "pickle"
    content: dict[str, Any] = {key: strange[rng.integers(len(strange))] for key in KEYS if rng.random() < 0.5}
    if rng.random() < 0.7:
        content["format"] = ["sdm segmentation 1", "sdm deepsdf 1", "sdm segmentation 99"][rng.integers(3)]
    torch.save(content, path)
    return "foreign"


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """A damaged model of segmentation, or something else, given to both readers of models."""
    path = folder / "model.pt"
    if rng.random() < 0.6:
        name, damage = drawn(rng)
        path.write_bytes(damage(_whole(), rng))
        label = f"segmentation {name}"
    else:
        label = _foreign(rng, path)
    with one_sentence(label) as outcome:
        load_model(path, "cpu")
        if label in ("foreign", "pickle"):
            raise Finding(f"{label}: taken for a model")
    with one_sentence(f"deepsdf {label}") as other:
        DeepSDF.load(path, "cpu")
        raise Finding(f"{label}: taken for a DeepSDF")
    return outcome[0] if outcome else Outcome(label, refused=not other)
