"""PhysicsNeMo: its functional of signed distances at points, a tree of Warp's that each call builds anew."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer

# The function's file, and the packages around it.
FILE = "physicsnemo.nn.functional.geometry.sdf"
PACKAGES = ("physicsnemo", "physicsnemo.core", "physicsnemo.nn", "physicsnemo.nn.functional", FILE.rpartition(".")[0])


class PhysicsNeMo(Peer):
    """`physicsnemo.nn.functional.signed_distance_field` with the sign of winding numbers.

    Its function also runs where the two dozen packages that others of its modules need are not installed
    (`pip install --no-deps nvidia-physicsnemo`).
    """

    name, package, module = "PhysicsNeMo", "nvidia-physicsnemo", "physicsnemo.nn.functional"
    note = "winding number; builds its tree in each call"

    def __init__(self, device: str = "cpu") -> None:
        self.device = device

    def missing(self) -> str | None:
        """Why it cannot run here."""
        why = super().missing()
        if why is None or "does not load" not in why:
            return why
        try:
            self.library  # noqa: B018
        except ImportError as error:
            return f"{why}; nor does its function alone: {error}"
        return None

    @property
    def library(self) -> Any:
        """The package, or its function's file where the package lacks others."""
        try:
            return super().library
        except ImportError:
            return file_alone()

    def build(self, case: Case) -> None:
        # There is no structure to keep: what is timed as a query is build and query together.
        self._vertices = torch.from_numpy(case.vertices).to(self.device)
        self._faces = torch.from_numpy(case.faces.astype("int32")).to(self.device)

    def signed_distance(self, points: Tensor) -> Tensor:
        found = self.library.signed_distance_field(self._vertices, self._faces, points, use_sign_winding_number=True)
        return found[0]


@cache
def file_alone() -> ModuleType:
    """The file of the function, without what the packages around it import.

    Raises:
        ImportError: It is not there, or lacks something itself.
    """
    if FILE in sys.modules:
        return sys.modules[FILE]
    spec = importlib.util.find_spec(PACKAGES[0])
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("physicsnemo is not installed")
    root = Path(next(iter(spec.submodule_search_locations))).parent
    before = {name: sys.modules.get(name) for name in PACKAGES}
    try:
        for name in PACKAGES:
            empty = ModuleType(name)
            empty.__path__ = [str(root.joinpath(*name.split(".")))]
            sys.modules[name] = empty
        return importlib.import_module(FILE)
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
