"""The boundary of every mesh of a family, found once, so that no batch waits for the device."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.shapes import Family
from sdm.stream.samplers import Sobol
from sdm.topology import boundary_edges

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
        self._known: dict[int, tuple[Tensor, Tensor]] = {}
        for theta in _probes(family):
            host = theta.cpu()
            for group in family.groups(theta.to(device), host):
                self.edges(group.vertices, group.faces)

    def edges(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """Directed boundary edges (E,2) int32 of faces; `vertices` (B,V,3) are looked at the first time alone."""
        # The faces are kept too, so that no other tensor can have their number.
        if id(faces) not in self._known:
            self._known[id(faces)] = (faces, boundary_edges(vertices, faces))
        return self._known[id(faces)][1]


def _probes(family: Family) -> list[Tensor]:
    theta = Sobol().theta(family, 0, torch.arange(PROBES))
    meshes = len(getattr(family, "meshes", ()))
    if not meshes:
        return [theta]
    # The first parameter of a folder of meshes is the number of the mesh.
    each = []
    for number in range(meshes):
        own = theta.clone()
        own[:, 0] = number + 0.5
        each.append(own)
    return each
