"""Launches of a narrow band, of which each takes some microseconds of a GPU's host: they decide a small band's time."""

from __future__ import annotations

from collections import Counter
from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode

import sdm
from sdm.bench.common.meshes import sphere
from sdm.kernels import launch

# They make or look at memory, and launch nothing.
FREE = (
    "empty",
    "view",
    "slice",
    "select",
    "split",
    "detach",
    "alias",
    "unbind",
    "lift_fresh",
    "scalar_dense",
    "expand",
)


class Counted(TorchDispatchMode):
    """Counts torch's operations by name."""

    def __init__(self) -> None:
        super().__init__()
        self.names: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if not any(word in func.name() for word in FREE):
            self.names[func.name()] += 1
        return func(*args, **(kwargs or {}))


def test_a_closed_mesh_takes_few_launches(monkeypatch):
    index = sdm.MeshIndex(sdm.TriangleMesh(*sphere(12)), "cpu", warn=False)
    grid = sdm.Grid.around(index.mesh, 64)
    index.narrow_band(grid)
    kernels: list[str] = []
    run = launch.run
    monkeypatch.setattr(launch, "threads", lambda: 1)
    monkeypatch.setattr(launch, "run", lambda kernel, *rest: kernels.append(kernel.key) or run(kernel, *rest))
    with Counted() as counted:
        index.narrow_band(grid)
    assert counted.names.total() <= 4, counted.names
    assert len(kernels) <= 21, kernels
