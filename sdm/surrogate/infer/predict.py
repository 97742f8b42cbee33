"""The surrogate that comes with the package, ready to answer."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from sdm.core.given_values import as_path
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, MeshError
from sdm.shapes import make_family
from sdm.surrogate.infer.runtime import Run, runner
from sdm.surrogate.infer.weights_file import load_weights
from sdm.surrogate.networks.cochlea_grid import GRID

WEIGHTS = Path(__file__).parents[1] / "weights"


def shipped_weights() -> Path | None:
    """The weights that come with the package, None if there are none."""
    found = sorted(WEIGHTS.glob("*.safetensors"))
    return found[0] if found else None


def load_surrogate(source: Path | str | None = None, *, device: torch.device | str = "cpu") -> nn.Module:
    """A trained surrogate: theta (B,4) = (a, alpha, b, phi) to maps (B,1,80,64,40) [mm] on `GRID`, negative inside.

    Args:
        source: A file of weights; by default those that come with the package.
        device: Where to put it.

    Differentiable in theta. Parameters are not checked: see `Family.check`.

    Raises:
        FormatError: A file that is not there or not a surrogate.
    """
    return load_weights(given_or_shipped(source), device)[0]


def given_or_shipped(source: Path | str | None) -> Path:
    """The file of weights that is named, else the one that comes with the package."""
    if source is not None:
        return as_path(source)
    found = shipped_weights()
    if found is None:
        raise FormatError("no surrogate comes with this installation: train one with `sdm train sdmnn`")
    return found


class Predictor:
    """A surrogate on the CPU, by the fastest backend that is installed.

    Args:
        source: A file of weights; by default those that come with the package.
        backend: "torch", "onnxruntime" or "openvino"; by default the fastest that is installed.
        threads: Cores to use; by default all of this process. The backend "torch" uses as many as
            `torch.set_num_threads` has set, whatever is given here, and one for SDMNN+ in bfloat16.

    Raises:
        FormatError: A file that is not there or not a surrogate.
        SDMError: A backend that is not installed.
    """

    def __init__(
        self, source: Path | str | None = None, *, backend: str | None = None, threads: int | None = None
    ) -> None:
        self.model, self.facts = load_weights(given_or_shipped(source))
        self._run: Run = runner(self.model, backend, threads)
        self._family = make_family("cochlea")

    def maps(self, theta: Any) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4).

        Raises:
            MeshError: theta is outside the box that the surrogate was trained on.
        """
        return self._run(self._family.check(theta).cpu())

    def predict(self, theta: Any) -> SDM:
        """The map of one theta (4,), in mm, negative inside.

        Raises:
            MeshError: Several samples, or parameters outside the box that the surrogate was trained on.
        """
        values = self.maps(theta)
        if len(values) != 1:
            raise MeshError(f"theta holds {len(values)} samples; predict() takes one: use maps() for a batch")
        return SDM(values[0, 0], GRID)


@lru_cache(maxsize=1)
def _quick() -> Predictor:
    """The shipped surrogate by torch: it is ready at once, where the others first compile."""
    return Predictor(backend="torch")


def predict(theta: Any) -> SDM:
    """The map of one theta (4,) = (a [mm], alpha [mm], b [1/rad], phi [rad]) by the shipped surrogate, on `GRID`.

    Raises:
        MeshError: theta is outside the box.
        FormatError: No surrogate comes with this installation.
    """
    return _quick().predict(theta)
