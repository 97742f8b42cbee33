"""Sphere tracing: pictures of a learned surface without a mesh, lit by normals from back-propagation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from sdm.core.given_values import as_path
from sdm.deepsdf.networks.model import DeepSDF
from sdm.errors import SDMError
from sdm.io.files.atomic import replacing

COLOUR = (0.86, 0.45, 0.38)
# Steps of a ray, what counts as a hit, and the share of a learned distance that is safe to go.
STEPS, HIT, CAUTION = 100, 1e-3, 0.8


def sphere_trace(model: DeepSDF, code: Any, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Points where rays meet the surface of a code in the unit sphere: J. Hart, "Sphere tracing", 1996.

    Args:
        model: The decoder.
        code: (D,).
        origins: (N,3), outside the shape.
        directions: (N,3) unit vectors.

    Returns:
        Points (N,3), and which rays hit (N,); the points of others mean nothing.
    """
    z = model.check_codes(code)[0]
    at, out = origins.to(model.device), directions.to(model.device)
    gone = torch.zeros(len(at), device=model.device, dtype=at.dtype)
    hit = torch.zeros(len(at), dtype=torch.bool, device=model.device)
    # Nothing is in front of the box, and past its far corner there is nothing more.
    alive = torch.arange(len(at), device=model.device)
    with torch.no_grad():
        for _ in range(STEPS):
            if not len(alive):
                break
            values = model.signed_distance(at[alive] + gone[alive, None] * out[alive], z)
            hit[alive] = values < HIT
            gone[alive] += CAUTION * values.clamp(min=0)
            far = (at[alive] + gone[alive, None] * out[alive]).norm(dim=1) > at[alive].norm(dim=1) + 1
            alive = alive[~(hit[alive] | far)]
    return at + gone[:, None] * out, hit


def render(model: DeepSDF, code: Any, *, size: int = 256, elevation: float = 30.0, azimuth: float = -60.0) -> Tensor:
    """A picture (size,size,3) in [0,1] of a code's surface, in parallel projection.

    Args:
        model: A trained model.
        code: (D,).
        size: Pixels along each axis.
        elevation: Of the eye above the plane of x and y [degrees].
        azimuth: Of the eye about z, from x on [degrees].

    Raises:
        SDMError: No pixels, or a code of another model.
    """
    if size < 1:
        raise SDMError(f"a picture of {size} pixels was requested; give 1 or more")
    eye, right, up = _camera(elevation, azimuth, model.device)
    across = torch.linspace(-1, 1, size, device=model.device, dtype=torch.float32)
    y, x = torch.meshgrid(-across, across, indexing="ij")
    origins = (2 * eye + x[..., None] * right + y[..., None] * up).reshape(-1, 3)
    points, hit = sphere_trace(model, code, origins, (-eye).expand_as(origins))
    picture = torch.ones(size * size, 3, device=model.device, dtype=torch.float32)
    if bool(hit.any()):
        normals = model.normals(points[hit], code)
        light = normalize(eye + 0.5 * up - 0.6 * right, dim=0)
        brightness = 0.25 + 0.6 * (normals @ light).clamp(min=0) + 0.15 * (normals @ eye).clamp(min=0)
        picture[hit] = (brightness[:, None] * picture.new_tensor(COLOUR) * 1.1).clamp(0, 1)
    return picture.reshape(size, size, 3)


def interpolation_strip(model: DeepSDF, first: Any, last: Any, *, count: int = 7, size: int = 192) -> Tensor:
    """Pictures (size, count * size, 3) of codes on the straight line between two codes (D,), ends included.

    Args:
        model: A trained model.
        first: The code to begin with.
        last: The code to end with.
        count: Pictures, at least 2.
        size: Pixels of one along each axis.

    Raises:
        SDMError: Fewer pictures, or a code of another model.
    """
    if count < 2:
        raise SDMError(f"a strip of {count} pictures has no ends; give 2 or more")
    a, b = model.check_codes(first)[0], model.check_codes(last)[0]
    return torch.cat([render(model, torch.lerp(a, b, n / (count - 1)), size=size) for n in range(count)], 1)


def save_picture(picture: Tensor, path: str | Path) -> None:
    """Write a picture (h,w,3) in [0,1] as PNG; needs no display.

    Raises:
        FormatError: A place that cannot be written.
        SDMError: No picture.
    """
    from matplotlib.image import imsave

    if not isinstance(picture, Tensor) or picture.ndim != 3 or picture.shape[2] != 3:
        raise SDMError(f"an object of type {type(picture).__name__} is no picture: give a tensor (h,w,3)")
    with replacing(as_path(path)) as part:
        imsave(part, picture.cpu().numpy(), format="png")


def _camera(elevation: float, azimuth: float, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    rise, turn = math.radians(elevation), math.radians(azimuth)
    eye: Sequence[float] = (math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise))
    right = (-math.sin(turn), math.cos(turn), 0.0)
    towards, side = (torch.tensor(v, device=device, dtype=torch.float32) for v in (eye, right))
    return towards, side, torch.linalg.cross(towards, side)
