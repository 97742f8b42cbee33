"""`sdm predict`: the map of a cochlea by the surrogate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def predict(
    *,
    a: float,
    alpha: float,
    b: float,
    phi: float,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    exact: bool = False,
    weights: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: shipped)")] = None,
    backend: Literal["torch", "onnxruntime", "openvino"] = "torch",
) -> int | None:
    """Predict the signed distance map of a cochlea from its shape parameters: negative inside, in millimetres.

    A small network answers in milliseconds on a CPU, on a fixed grid of 80 x 64 x 40 voxels of 0.2 mm; how far it is
    from the exact map is in its model card. It refuses parameters outside the box that it was trained on.

    Args:
        a: Radius of the spiral at the base, 2 to 5 [mm].
        alpha: Height of the wave of the centre line, 0 to 1.2 [mm].
        b: Decay of the radius, 0.05 to 0.25 [1/rad].
        phi: Phase of the wave, -0.785 to 0.785 [rad].
        out: File to write; its ending is the format: .nii.gz, .nii, .npz, .nrrd, .mha, .vti, .zarr, .nvdb.
        exact: Compute the exact map instead, also outside that box.
        weights: Weights of another surrogate, from `sdm train sdmnn`.
        backend: What runs the network; all but torch are optional, and prepare for seconds before they are quick.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.errors import SDMError
    from sdm.io.maps.formats import check_target
    from sdm.surrogate.infer.exact_map import exact_map
    from sdm.surrogate.infer.predict import Predictor

    if exact and (weights is not None or backend != "torch"):
        raise SDMError("--exact computes the map without a network: leave out --weights and --backend, or --exact")
    refuse_inputs([out], [weights])
    check_target(out)
    theta = [a, alpha, b, phi]
    field = exact_map(theta) if exact else Predictor(weights, backend=backend).predict(theta)
    field.save(out)
    how = "exact" if exact else "surrogate"
    print(f"{out}: {' x '.join(map(str, field.grid.shape))} voxels of {field.grid.spacing[0]:g} mm, {how}")
    return None
