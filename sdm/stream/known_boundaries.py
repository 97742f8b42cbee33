"""The boundary of every mesh of a family, found once, so that no batch waits for the device."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.shapes import Family
from sdm.stream.samplers import Sobol
from sdm.topology.boundary_edges import boundary_edges

# Vertices count as one if they are at one place in this many shapes.
PROBES = 4


class Topology:
    """Boundary edges of a family's faces on a device.

    Args:
        family: The family.
        device: Where its faces are used.

    Every mesh of a family is visited here, which waits for the device; `edges` does not wait afterwards. Vertices at
    one position in a few probes of the family count as one, whatever the batch: a sample must not depend on its
    neighbours.
    """

    def __init__(self, family: Family, device: torch.device) -> None:
        # As long as somebody has the faces: a family may make new ones for each batch.
        self._known: WeakIdKeyDictionary = WeakIdKeyDictionary()
        for theta in _probes(family):
            host = theta.cpu()
            for group in family.groups(theta.to(device), host):
                self.edges(group.vertices, group.faces)

    def edges(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """Directed boundary edges (E,2) int32 of faces; `vertices` (B,V,3) are looked at the first time alone."""
        edges: Tensor | None = self._known.get(faces)
        if edges is None:
            self._known[faces] = edges = boundary_edges(vertices, faces)
        return edges


def _probes(family: Family) -> list[Tensor]:
    theta = Sobol().theta(family, 0, torch.arange(PROBES, device="cpu"))
    return family.probes(theta)
