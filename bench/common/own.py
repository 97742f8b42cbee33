"""Meshes and peers of a user's own: one small class each, in a Python file that `sdm bench --add FILE.py` reads.

Every class in the file that inherits from `OwnMesh` is a mesh, every one that inherits from `sdm.bench.peers.Peer` a
peer. Peers are made without arguments, or with the device if their `__init__` takes one. bench/README.md has an
example.
"""

from __future__ import annotations

import inspect
import runpy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import sdm
from sdm.bench.common.meshes import Case
from sdm.bench.peers import Peer


class OwnMesh(ABC):
    """A mesh from code; one from a file needs no class: `sdm bench --meshes part.stl`.

    Attributes:
        name: What tables call it.
    """

    name: str

    @abstractmethod
    def arrays(self) -> tuple[Any, Any]:
        """Vertices (V,3) and faces (F,3), counter-clockwise seen from outside."""


@dataclass
class Own:
    """Meshes and peers of the user's files."""

    cases: dict[str, Case] = field(default_factory=dict)
    makers: list[Callable[..., Peer]] = field(default_factory=list)

    def peers(self, device: str) -> list[Peer]:
        """The peers, each told the device if it asks."""
        return [maker(device) if inspect.signature(maker).parameters else maker() for maker in self.makers]


def load_own(files: Sequence[Path]) -> Own:
    """Run the user's files and collect their classes.

    Raises:
        FormatError: A file that is not there, or holds neither a mesh nor a peer.
        MeshError: A mesh that is none.
    """
    found = Own()
    for path in files:
        if not path.is_file():
            raise sdm.FormatError(f"there is no file {path} with meshes or peers to add")
        try:
            names = runpy.run_path(str(path), run_name=f"added_{path.stem}")
        # Whatever a user's program does.
        except Exception as error:
            raise sdm.FormatError(f"{path} does not run as a Python file: {type(error).__name__}: {error}") from error
        # Those that were only imported belong to another module.
        classes = [c for c in names.values() if inspect.isclass(c) and c.__module__ == names["__name__"]]
        classes = [c for c in classes if not inspect.isabstract(c)]
        meshes = [c() for c in classes if issubclass(c, OwnMesh)]
        makers = [c for c in classes if issubclass(c, Peer)]
        if not meshes and not makers:
            raise sdm.FormatError(
                f"{path} has no class that inherits from OwnMesh or Peer and defines what they ask for"
            )
        for mesh in meshes:
            checked = sdm.TriangleMesh(*mesh.arrays(), mesh.name)
            vertices, faces = (np.ascontiguousarray(a.numpy()) for a in (checked.vertices, checked.faces))
            found.cases[mesh.name] = Case(mesh.name, vertices, faces, frozenset(("own",)))
        found.makers += makers
    return found
