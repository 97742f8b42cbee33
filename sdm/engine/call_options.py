"""Options of the public calls as keyword types, which the overloads of each call share."""

from __future__ import annotations

from typing import TypedDict

import torch

from sdm.engine.arguments import Orient, Sign


class SignOptions(TypedDict, total=False):
    """Signs of maps."""

    sign: Sign
    hole_size: float | None


class ComparedSignOptions(SignOptions, total=False):
    """Signs of maps, and whether two ways to them are compared."""

    compare_signs: bool


class MapOptions(ComparedSignOptions, total=False):
    """Grid, device and signs of one map."""

    resolution: int | None
    margin: float | None
    device: str | torch.device | None
    orient: Orient


class ListOptions(MapOptions, total=False):
    """The same of maps of many meshes, and their memory."""

    max_bytes: int | None


class BatchOptions(SignOptions, total=False):
    """Grid, device and signs of a batch that shares its faces."""

    resolution: int | None
    margin: float | None
    device: str | torch.device | None


class PointOptions(TypedDict, total=False):
    """Device and signs of points."""

    device: str | torch.device | None
    sign: Sign


class PointListOptions(PointOptions, total=False):
    """The same of points of many meshes, and their memory."""

    max_bytes: int | None
