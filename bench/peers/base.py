"""Interface of a peer: a library that is compared with."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor

from sdm import Grid
from sdm.bench.common.meshes import Case


class Peer(ABC):
    """A library that measures signed distances: built on one mesh, asked often. Negative inside, as everywhere.

    Attributes:
        name: What tables call it.
        package: The distribution whose version counts.
        module: What must import for it to run.
        note: How it was asked, in a few words.
        device: Where its points and results live.
        parts: Which of `"distance"` and `"sign"` it answers alone.
        points_too: Whether it takes scattered points; if not, only grids.
        fewest_points: Points of a call below which it leaves cores idle, so that it is timed on no fewer.
    """

    name: str
    package: str
    module: str
    note: str = ""
    device: str = "cpu"
    parts: tuple[str, ...] = ()
    points_too: bool = True
    fewest_points: int = 1

    def missing(self) -> str | None:
        """Why it cannot run here, as a sentence; None if it can."""
        if self.device.startswith("cuda") and not torch.cuda.is_available():
            return f"{self.name} was requested on {self.device}, but no CUDA device is there"
        try:
            importlib.import_module(self.module)
        except ImportError as error:
            known = (
                isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] == self.module.split(".")[0]
            )
            return f"{self.name} is not installed" if known else f"{self.name} is installed but does not load: {error}"
        return None

    @property
    def library(self) -> Any:
        """The imported module: optional, so that nothing here may import it at the top."""
        return importlib.import_module(self.module)

    def available(self) -> bool:
        """True if it can run here."""
        return self.missing() is None

    @abstractmethod
    def build(self, case: Case) -> None:
        """Make the acceleration structure of a mesh, or what the library keeps in place of one."""

    @abstractmethod
    def signed_distance(self, points: Tensor) -> Tensor:
        """Signed distances (N,) of points (N,3) float32 on `device`."""

    def unsigned_distance(self, points: Tensor) -> Tensor:
        """Distances alone, where `parts` has them."""
        raise NotImplementedError

    def inside(self, points: Tensor) -> Tensor:
        """True for points inside, without distances, where `parts` has it."""
        raise NotImplementedError

    def prepare(self, grid: Grid) -> None:
        """Whatever a grid needs that is not part of the question: here, its points on the device."""
        self._grid = grid
        self._points = grid.points().reshape(-1, 3).to(self.device)

    def signed_distance_map(self, grid: Grid) -> Tensor:
        """The map (nx,ny,nz) of a grid that `prepare` has seen."""
        if grid is not self._grid:
            raise ValueError("call prepare(grid) first")
        return self.signed_distance(self._points).reshape(grid.shape)
