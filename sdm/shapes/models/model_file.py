"""Files of shape models: .npz of plain arrays, read without pickle."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from sdm.errors import FormatError, MeshError
from sdm.io.files.atomic import replacing
from sdm.shapes.models.statistical_shape import StatisticalShape

KIND, VERSION = "sdm shape model", 1
NAMES = {KIND: "a shape model of points", "sdm model of maps": "a model of maps (--method sdm)"}
ARRAYS = ("mean", "modes", "deviations", "faces", "limit")
NO_MODEL = "is not a shape model: give a file that sdm shape-model build wrote"


def save_model(model: StatisticalShape, path: Path) -> None:
    """Write a shape model.

    Raises:
        FormatError: The path does not end with .npz, or cannot be written.
    """
    arrays = {"mean": model.mean, "modes": model.modes, "deviations": model.deviations, "faces": model.triangles}
    content: dict[str, Any] = {name: value.numpy() for name, value in arrays.items()}
    write_arrays(path, {**content, "limit": np.float64(model.limit)}, KIND, model.facts)


def load_model(path: Path) -> StatisticalShape:
    """The shape model of a file.

    Raises:
        FormatError: It cannot be read, or is something else.
    """
    arrays, facts = read_arrays(path, KIND, ARRAYS)
    try:
        model = StatisticalShape(*(arrays[name] for name in ARRAYS[:4]), limit=float(arrays["limit"]), facts=facts)
    except (MeshError, TypeError, ValueError, RuntimeError, IndexError) as error:
        raise FormatError(f"{path} holds no sound shape model: {error}") from error
    return model


def write_arrays(path: Path, arrays: dict[str, Any], kind: str, facts: dict[str, Any]) -> None:
    """Write arrays with their kind and facts as .npz.

    Raises:
        FormatError: The path does not end with .npz, or cannot be written.
    """
    if path.suffix.lower() != ".npz":
        raise FormatError(f"{path} does not end with .npz, as shape models do")
    header = json.dumps({"kind": kind, "version": VERSION, "facts": facts})
    with replacing(path) as part, part.open("wb") as file:
        np.savez_compressed(file, header=np.array(header), **arrays)


def read_arrays(path: Path, kind: str, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and facts of a file that `write_arrays` wrote.

    Raises:
        FormatError: It cannot be read, or is something else.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            header = json.loads(str(archive["header"]))
            held, version = header.get("kind"), header.get("version")
            arrays = {name: archive[name] for name in names} if (held, version) == (kind, VERSION) else {}
    except OSError as error:
        raise FormatError(f"{path} cannot be read: {error.strerror or error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, RecursionError) as error:
        raise FormatError(f"{path} {NO_MODEL}") from error
    if held != kind:
        raise FormatError(f"{path} is {NAMES.get(str(held), 'something else')}, and {NAMES[kind]} is needed")
    if version != VERSION:
        raise FormatError(f"{path} is of another version of sdm: build the model again")
    facts = header.get("facts")
    return arrays, facts if isinstance(facts, dict) else {}


def kind_of(path: Path) -> str | None:
    """The kind of a model's file, None of a file that cannot be read or is none."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return json.loads(str(archive["header"])).get("kind")
    except (OSError, KeyError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, RecursionError):
        return None
