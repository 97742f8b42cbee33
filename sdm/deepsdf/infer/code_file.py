"""Codes as files: the code, and where the shape is."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from sdm.core.given_values import as_path
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import FormatError
from sdm.io.files.atomic import replacing

VERSION = 1


@dataclass(frozen=True, eq=False)
class ShapeCode:
    """A shape as a model knows it.

    Args:
        code: (D,) float32.
        sphere: Its normalisation.
    """

    code: Tensor
    sphere: UnitSphere


def save_code(shape: ShapeCode, path: str | Path) -> None:
    """Write `.npz`, atomically."""
    sphere = np.array([*shape.sphere.centre, shape.sphere.radius])
    with replacing(as_path(path)) as part, part.open("wb") as file:
        np.savez(file, version=VERSION, code=shape.code.detach().cpu().numpy(), sphere=sphere)


def load_code(path: str | Path) -> ShapeCode:
    """Read what `save_code` wrote.

    Raises:
        FormatError: The file is not there, is something else, or is of another version.
    """
    try:
        with as_path(path).open("rb") as whole, np.load(whole, allow_pickle=False) as file:
            version, code, sphere = int(file["version"]), file["code"], file["sphere"]
    except FileNotFoundError:
        raise FormatError(f"{path} is not there; make it with sdm encode") from None
    except (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path} is no code of a shape; give a file that sdm encode wrote") from error
    if version != VERSION:
        raise FormatError(f"{path} is a code of version {version}, and this program reads version {VERSION}")
    if code.dtype.kind != "f" or code.ndim != 1 or sphere.dtype.kind not in "iuf" or sphere.shape != (4,):
        raise FormatError(f"{path} is no code of a shape: it needs a code of numbers, and a centre with a radius")
    x, y, z, radius = sphere.tolist()
    return ShapeCode(torch.from_numpy(code), UnitSphere((x, y, z), radius))
