"""The exact map of one cochlea, also outside the box that surrogates are trained on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import torch

from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.errors import MeshError
from sdm.shapes import make_family
from sdm.surrogate.networks.cochlea_grid import GRID, SPACING_MM

# Larger than any cochlea: a typing error, which would ask for more memory than there is.
LARGEST_MM = 20.0


def exact_map(theta: Sequence[float], device: str | torch.device | None = "cpu") -> SDM:
    """The exact map [mm] of theta = (a, alpha, b, phi), on the surrogates' grid if the shape fits into it.

    A shape that does not fit has voxels of the same size around it. Outside the family's box the surface may meet
    itself; inside is then where the winding number is at least 1.

    Raises:
        MeshError: Not four finite numbers, or a and alpha of which no cochlea can be made.
    """
    values = [real(x) for x in theta] if isinstance(theta, Iterable) and np.ndim(theta) == 1 else []
    if len(values) != 4 or not all(math.isfinite(x) for x in values):
        raise MeshError(f"theta is {theta!r}; give four finite numbers a, alpha, b, phi")
    a, alpha, b, _ = values
    if not 0 < a <= LARGEST_MM or not 0 <= alpha <= LARGEST_MM or not 0 <= b <= 1:
        raise MeshError(
            f"a = {a:g}, alpha = {alpha:g} and b = {b:g} give no cochlea: a is above 0 and at most {LARGEST_MM:g} mm, "
            f"alpha at least 0 and at most {LARGEST_MM:g} mm, b from 0 to 1 per radian"
        )
    family = make_family("cochlea")
    mesh = TriangleMesh(family.vertices(torch.tensor([values]))[0], family.faces, family.name)
    low, high = mesh.bounds
    last = np.add(GRID.origin, SPACING_MM * np.subtract(GRID.shape, 1))
    fits = bool((low > GRID.origin).all() and (high < last).all())
    grid = GRID if fits else Grid.around(mesh, spacing=SPACING_MM)
    return signed_distance_map(mesh, grid, device=device)
