"""PhysicsNeMo: its functional of signed distances at points, a tree of Warp's that each call builds anew."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class PhysicsNeMo(Peer):
    """`physicsnemo.nn.functional.signed_distance_field` with the sign of winding numbers."""

    name, package, module = "PhysicsNeMo", "nvidia-physicsnemo", "physicsnemo.nn.functional"
    note = "winding number; builds its tree in each call"

    def __init__(self, device: str = "cpu") -> None:
        self.device = device

    def build(self, case: Case) -> None:
        # There is no structure to keep: what is timed as a query is build and query together.
        self._vertices = torch.from_numpy(case.vertices).to(self.device)
        self._faces = torch.from_numpy(case.faces.astype("int32")).to(self.device)

    def signed_distance(self, points: Tensor) -> Tensor:
        found = self.library.signed_distance_field(self._vertices, self._faces, points, use_sign_winding_number=True)
        return found[0]
