"""A family by one name everywhere: a registered one, a class in a user's file, or a shape model's file."""

from __future__ import annotations

import copyreg
import hashlib
import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from sdm.errors import MeshError, SDMError
from sdm.shapes.family import Family, Parameter
from sdm.shapes.registry import families, make_family

NAMES = "a family is a registered name, FILE.py:NAME, or a shape model's file, MODEL.npz"
CODE, MODEL, NETWORK = ".py", ".npz", ".pt"


def load_family(name: str | Path | Family, **options: Any) -> Family:
    """The family that a name says.

    Args:
        name: "cochlea" or another registered name; "FILE.py:NAME", a subclass of `Family`, an instance of one, or a
            function that makes one, in a file of yours, **which is run**; or "MODEL.npz", which
            `sdm shape-model build` wrote. A family is given back as it is.
        options: Of the family's class, for example `triangles=2000`; those that are None count as not given.

    Raises:
        MeshError: There is no such family, or it does not keep what families promise, in one sentence.
    """
    if isinstance(name, Family):
        return name
    text = str(name)
    given = {key: value for key, value in options.items() if value is not None}
    path, colon, attribute = text.rpartition(":")
    if colon and path.lower().endswith(CODE):
        return _of_code(Path(path), attribute, given)
    if text.lower().endswith(CODE):
        raise MeshError(f"{text} is a file of code: say which family of it, {text}:NAME")
    if text.lower().endswith(MODEL):
        from sdm.shapes.models.model_file import load_model

        if given:
            raise MeshError(f"{text} is a shape model, whose meshes are what they are: it takes no {next(iter(given))}")
        return load_model(Path(text))
    if text.lower().endswith(NETWORK):
        raise MeshError(
            f"{text} is a DeepSDF, which has codes and no meshes of its own: sdm fit and sdm decode take it"
        )
    if text not in families or families[text].needs_files:
        known = ", ".join(key for key, family in families.items() if not family.needs_files)
        raise MeshError(f"there is no family called {text!r} ({known}); {NAMES}")
    return make_family(text, **given)


def family_record(family: Family) -> dict[str, Any]:
    """Name, parameters and checksums of a family, ready for JSON: what datasets and trained models keep of it.

    `fingerprint` is of faces, constants and parameters; `reference` holds mean and root mean square of x, y, z at three
    places of the box, since code may change under equal constants. No part of it is ever run.
    """
    if not isinstance(family, Family):
        raise MeshError(f"an object of type {type(family).__name__} is no family of shapes: sdm.shapes has some")
    return {
        "name": family.name,
        "parameters": [[p.name, p.low, p.high, p.unit] for p in family.parameters],
        "fingerprint": family.fingerprint,
        "reference": _reference(family),
    }


def differs_from(family: Family, record: dict[str, Any]) -> str | None:
    """The first thing in which a family differs from a record of `family_record`, in words; None if it is the same."""
    return difference(family_record(family), record)


def difference(own: dict[str, Any], record: dict[str, Any]) -> str | None:
    """The first thing in which two records of `family_record` differ, in words; None if they are of one family."""
    for key, word in (("name", "name"), ("parameters", "parameters"), ("fingerprint", "faces or constants")):
        if own[key] != record.get(key):
            return f"{word}"
    kept = record.get("reference")
    size = max(abs(x) for x in own["reference"]) or 1.0
    if not isinstance(kept, list) or len(kept) != len(own["reference"]):
        return "record"
    if max(abs(a - b) for a, b in zip(own["reference"], kept, strict=True)) > 1e-4 * size:
        return "vertices"
    return None


def _reference(family: Family) -> list[float]:
    count = len(family.parameters)
    unit = torch.tensor([0.3, 0.5, 0.7], device="cpu")[:, None].expand(3, count)
    with torch.no_grad():
        points = family.vertices(family.from_unit(unit)).double().cpu()
    sums = torch.cat([points.mean(1), points.square().mean(1).sqrt()], 1)
    return [float(f"{x:.7g}") for x in sums.reshape(-1).tolist()]


def _of_code(path: Path, name: str, options: dict[str, Any]) -> Family:
    module = _run_file(path)
    found = getattr(module, name, None) if name.isidentifier() else None
    if found is None:
        own = [key for key, value in vars(module).items() if _is_own(value, module)]
        raise MeshError(f"{path} has no family called {name!r}" + (f"; it has {', '.join(own)}" if own else ""))
    try:
        family = found(**options) if callable(found) and not isinstance(found, Family) else found
    except SDMError:
        raise
    except Exception as error:
        raise MeshError(f"{name} of {path} cannot be made: {_said(error)}") from error
    if not isinstance(family, Family):
        raise MeshError(f"{name} of {path} is {type(family).__name__}, not a sdm.shapes.Family")
    if isinstance(found, Family) and options:
        raise MeshError(f"{name} of {path} is ready-made: it takes no {next(iter(options))}")
    if family.name == Family.name:
        type(family).name = type(family).__name__.lower()
    check_promises(family, f"{name} of {path}")
    if type(family).__module__ == module.__name__:
        # Another process finds the class by its file, not by the name of a module that is not there.
        copyreg.pickle(type(family), _reduced)
    return family


def check_promises(family: Family, said: str, device: torch.device | str = "cpu") -> None:
    """Refuse a family whose parts do not fit together, by two samples on a device.

    Raises:
        MeshError: In one sentence that begins with `said`.
    """
    try:
        parameters, faces = family.parameters, family.triangles
        family.faces_on("cpu")
    except Exception as error:
        raise MeshError(f"{said} needs `parameters` and `triangles`: {_said(error)}") from error
    if not parameters or not all(isinstance(p, Parameter) for p in parameters):
        raise MeshError(f"{said} needs `parameters`, one sdm.shapes.Parameter or more")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype != torch.int32:
        raise MeshError(f"{said} has triangles {tuple(faces.shape)} {faces.dtype}; (F, 3) torch.int32 is needed")
    try:
        with torch.no_grad():
            points = family.vertices(family.sample(2, device=device))
    except Exception as error:
        raise MeshError(f"{said} fails in vertices(theta), (2, {len(parameters)}): {_said(error)}") from error
    if not isinstance(points, torch.Tensor) or points.ndim != 3 or points.shape[0] != 2 or points.shape[2] != 3:
        shape = tuple(points.shape) if isinstance(points, torch.Tensor) else type(points).__name__
        raise MeshError(f"{said} gives vertices {shape} for theta (2, {len(parameters)}); (2, V, 3) is needed")
    if points.dtype != torch.float32:
        raise MeshError(f"{said} gives vertices of {points.dtype}; torch.float32 is needed")
    if not bool(points.isfinite().all()):
        raise MeshError(f"{said} gives vertices that are not finite")
    if not 0 <= int(faces.min()) <= int(faces.max()) < points.shape[1]:
        raise MeshError(
            f"{said} has triangles of vertices up to {int(faces.max())}, and only {points.shape[1]} of them"
        )


def _run_file(path: Path) -> ModuleType:
    """The module of a user's file, run once for what it holds."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {error.strerror or error}") from error
    place = path.resolve()
    digest = hashlib.sha256(str(place).encode() + content).hexdigest()[:12]
    name = f"sdm_family_{place.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, place)
    # None of an ending that is not Python's, as .PY is.
    if spec is None or spec.loader is None:
        raise MeshError(f"{path} does not end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    # A file may also ask to exit.
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise MeshError(f"{path} cannot be run: {_said(error)}") from error
    return module


def _is_own(value: Any, module: ModuleType) -> bool:
    kind = value if inspect.isclass(value) else type(value)
    return issubclass(kind, Family) and kind.__module__ == module.__name__


def _reduced(family: Family) -> tuple[Any, ...]:
    kind = type(family)
    return _made_again, (inspect.getfile(kind), kind.__name__, family.__getstate__())


def _made_again(path: str, name: str, state: dict[str, Any]) -> Family:
    kind = getattr(_run_file(Path(path)), name)
    if kind.name == Family.name:
        kind.name = kind.__name__.lower()
    family = kind.__new__(kind)
    family.__dict__.update(state)
    copyreg.pickle(kind, _reduced)
    return family


def _said(error: BaseException) -> str:
    line = str(error).strip().split("\n")[0]
    where = f" (line {error.lineno})" if isinstance(error, SyntaxError) and error.lineno else ""
    return f"{type(error).__name__}{': ' + line if line else ''}{where}"
