"""The three backends by name."""

from __future__ import annotations

import torch

from sdm.device import choose_device
from sdm.errors import SDMError
from sdm.fit.backend import Backend
from sdm.fit.exact import TRIANGLES, ExactBackend
from sdm.fit.from_grid import GridBackend
from sdm.shapes import Cochlea

NAMES = ("exact", "surrogate", "hybrid")


def make_backends(
    name: str, *, triangles: int = TRIANGLES, device: str | torch.device | None = None
) -> tuple[Backend, Backend | None]:
    """The backend to begin with, and the one to finish with if that is another.

    Args:
        name: "exact", "surrogate", or "hybrid" for the surrogate first and exact to finish.
        triangles: Triangles of the exact backend's meshes.
        device: Where to compute; by default a GPU if there is one.

    Raises:
        SDMError: No such backend, or no surrogate is installed.
    """
    if name not in NAMES:
        raise SDMError(f"there is no backend called {name!r}; use {', '.join(NAMES)}")
    where = choose_device(device)
    exact = ExactBackend(Cochlea(triangles), where) if name != "surrogate" else None
    if exact is not None and name == "exact":
        return exact, None
    return surrogate_backend(where), exact


def surrogate_backend(device: torch.device) -> GridBackend:
    """The surrogate that is shipped with the package, as a backend.

    Raises:
        SDMError: It is not there.
    """
    try:
        from sdm.surrogate import GRID, load_surrogate
    except ImportError as error:
        raise SDMError("no surrogate is installed here: use the exact backend") from error
    return GridBackend(load_surrogate(device=device), GRID, device=device)
