"""Backend of a fit: signed distances at points, and their derivatives by parameters and points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.shapes import Parameter


@dataclass(frozen=True, eq=False)
class Distances:
    """Signed distances at N points of the shape's own frame, with their first derivatives.

    Args:
        values: (N,) float64 [mm], negative inside.
        by_theta: (N,P) float64, by the shape parameters.
        by_point: (N,3) float64, by the point: the outward direction.
    """

    values: Tensor
    by_theta: Tensor
    by_point: Tensor


class Backend(Protocol):
    """Source of signed distances: `ExactBackend`, `GridBackend`, or yours."""

    name: str
    # The shape parameters with their ranges.
    parameters: tuple[Parameter, ...]
    # A point in the shape's own frame about which it is turned [mm].
    centre: Tensor
    device: torch.device
    # How far values may be from true distances [mm]: the search for the surface's band allows for it.
    slack: float
    # Shapes built so far: every other theta costs one.
    evaluations: int

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) float64 for theta (P,)."""
        ...

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """The same with their derivatives."""
        ...


@runtime_checkable
class HasRough(Protocol):
    """A backend that has a cheaper one for coarse images."""

    def rough(self) -> Backend | None:
        """The same shapes, less exactly and for less time, turned about the same centre; None if there is none."""
        ...


def rough_of(backend: Backend) -> Backend:
    """Backend for coarse images: the backend's cheaper one if there is one, else itself."""
    return (backend.rough() if isinstance(backend, HasRough) else None) or backend


@runtime_checkable
class HasFiner(Protocol):
    """A backend that can do with finer meshes."""

    def finer(self) -> Backend | None:
        """The same shapes by meshes of four times as many triangles, turned about the same centre; None if its shapes
        are those of their meshes.
        """
        ...


def finer_of(backend: Backend) -> Backend | None:
    """Backend of finer meshes, to see what the facets of the usual ones do; None if there is none."""
    return backend.finer() if isinstance(backend, HasFiner) else None


@runtime_checkable
class HasExact(Protocol):
    """A surrogate that knows the backend which it stands for."""

    # Anchors fits near their end (`sdm.fit.model.anchor`): the same shapes in the same frame. None: no anchors.
    exact: Backend | None


@runtime_checkable
class HasError(Protocol):
    """A backend whose values are a model's, and off by something that no residual tells."""

    # Root mean square error of the values near the surface [mm]; None: not known.
    error: float | None
    # Edge of the patches of the surface whose errors are taken to be independent [mm].
    patch: float


@runtime_checkable
class HasSurface(Backend, Protocol):
    """A backend without a family of meshes that has a surface all the same."""

    def surface_mesh(self, theta: Tensor) -> TriangleMesh:
        """The surface for theta (P,) in the shape's own frame."""
        ...


def exact_of(backend: Backend) -> Backend | None:
    """Exact backend to anchor a fit by; None if the backend has none."""
    return backend.exact if isinstance(backend, HasExact) else None
