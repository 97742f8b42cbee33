"""The three backends by name."""

from __future__ import annotations

from pathlib import Path

import torch

from sdm.core.device import choose_device
from sdm.errors import SDMError
from sdm.fit.model.backend import Backend
from sdm.fit.model.exact import TRIANGLES, ExactBackend
from sdm.fit.model.scaled_family import MirroredFamily
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import make_family
from sdm.surrogate import COARSE_GRID, GRID, SDMNNPlus, load_weights
from sdm.surrogate.infer.predict import given_or_shipped
from sdm.surrogate.infer.weights_file import near_error

NAMES = ("exact", "surrogate", "hybrid")


def make_backends(
    name: str,
    *,
    triangles: int = TRIANGLES,
    weights: Path | str | None = None,
    device: str | torch.device | None = None,
    mirror: bool = False,
) -> tuple[Backend, Backend | None]:
    """The backend to begin with, and the one to finish with if that is another.

    Args:
        name: "exact"; "surrogate", anchored near the end by two exact evaluations; or "hybrid" for the surrogate
            first and exact to finish.
        triangles: Triangles of the exact backend's meshes.
        weights: A surrogate's weights; by default those that come with the package.
        device: Where to compute; by default a GPU if there is one.
        mirror: Mirror images of the cochleae, ears of the other side; exact alone.

    Raises:
        SDMError: No such backend, or a surrogate of mirror images.
        FormatError: No surrogate comes with this installation.
    """
    if name not in NAMES:
        raise SDMError(f"there is no backend called {name!r}; use {', '.join(NAMES)}")
    if mirror and name != "exact":
        raise SDMError(f"mirrored cochleae are fitted by the exact backend, and {name} was asked for")
    where = choose_device(device)
    family = make_family("cochlea", triangles)
    exact = ExactBackend(MirroredFamily(family) if mirror else family, where)
    if name == "exact":
        return exact, None
    model, facts = load_weights(given_or_shipped(weights), where)
    rough = (model.coarse, COARSE_GRID) if isinstance(model, SDMNNPlus) else None
    surrogate = GridBackend(model, GRID, device=where, rough=rough, exact=exact, error=near_error(facts))
    return surrogate, exact if name == "hybrid" else None
