"""`sdm predict`: the map of a shape by a surrogate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.printed_line import print_line


def predict(
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    model: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: cochlea)")] = None,
    values: Annotated[tuple[str, ...], tyro.conf.arg(name="set", metavar="NAME=VALUE ...", help_behavior_hint="")] = (),
    a: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")] = None,
    alpha: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")] = None,
    b: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")] = None,
    phi: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")] = None,
    exact: bool = False,
    weights: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: shipped)")] = None,
    backend: Literal["torch", "onnxruntime", "openvino"] = "torch",
) -> int | None:
    """Predict the signed distance map of a shape from its parameters, without a mesh: negative inside.

    With --model, of a family that sdm train sdmnn --family was trained on. Without it, of a cochlea in millimetres: a
    small network answers in milliseconds on a CPU, on a fixed grid of 80 x 64 x 40 voxels of 0.2 mm. How far a
    surrogate is from the exact map is in its model card. It refuses parameters outside the box that it was trained on.

    Args:
        out: File to write; its ending is the format: .nii.gz, .nii, .npz, .nrrd, .mha, .mhd, .vti, .zarr, .nvdb.
        model: Folder that sdm train sdmnn --family wrote.
        values: All parameters by name, for example a=3.6 alpha=0.3 b=0.139 phi=-0.17.
        a: Of a cochlea, radius of the spiral at the base, 2 to 5 [mm].
        alpha: Height of the wave of the centre line, 0 to 1.2 [mm].
        b: Decay of the radius, 0.05 to 0.25 [1/rad].
        phi: Phase of the wave, -0.785 to 0.785 [rad].
        exact: Compute the exact map of a cochlea instead, also outside that box.
        weights: Weights of another surrogate of the cochlea, from `sdm train sdmnn` without --family.
        backend: What runs the network; all but torch are optional, and prepare for seconds before they are quick.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.errors import SDMError
    from sdm.io.maps.formats import check_target
    from sdm.surrogate.families.family_file import FamilyPredictor
    from sdm.surrogate.infer.exact_map import exact_map
    from sdm.surrogate.infer.predict import Predictor

    if exact and (weights is not None or backend != "torch" or model is not None):
        raise SDMError("--exact computes the map without a network: leave out --weights, --model and --backend, or it")
    if model is not None and weights is not None:
        raise SDMError("--model is a family's surrogate and --weights one of the cochlea: give one of them")
    own = {"a": a, "alpha": alpha, "b": b, "phi": phi}
    given = _numbers(values) | {name: value for name, value in own.items() if value is not None}
    refuse_inputs([out], [weights])
    check_target(out)
    if model is not None:
        predictor = FamilyPredictor(model, backend=backend)
        field = predictor.predict(_in_order(given, [str(p[0]) for p in predictor.parameters], str(model)))
    else:
        theta = _in_order(given, list(own), "the cochlea")
        field = exact_map(theta) if exact else Predictor(weights, backend=backend).predict(theta)
    field.save(out)
    how, unit = "exact" if exact else "surrogate", " mm" if model is None else ""
    print_line(f"{out}: {' x '.join(map(str, field.grid.shape))} voxels of {field.grid.spacing[0]:.4g}{unit}, {how}")
    return None


def _numbers(words: tuple[str, ...]) -> dict[str, float]:
    """Values by name of words like a=3.6."""
    from sdm.errors import SDMError

    found: dict[str, float] = {}
    for word in words:
        name, equals, value = word.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = None
        if not equals or not name or number is None or name in found:
            why = "is there twice" if name in found else "is not NAME=NUMBER"
            raise SDMError(f"--set takes parameters like a=3.6, each once: {word!r} {why}")
        found[name] = number
    return found


def _in_order(given: dict[str, float], names: list[str], whose: str) -> list[float]:
    from sdm.errors import SDMError

    unknown, missing = [n for n in given if n not in names], [n for n in names if n not in given]
    if unknown:
        raise SDMError(f"{whose} has no parameter {unknown[0]!r}; it has {', '.join(names)}")
    if missing:
        raise SDMError(f"{whose} needs {', '.join(missing)} too: --set {' '.join(f'{n}=...' for n in missing)}")
    return [given[name] for name in names]
