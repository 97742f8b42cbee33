"""Kernels compiled before anybody waits for them: one small call of each kind."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

from sdm.errors import SDMWarning

RESOLUTION = 24


def steps(device: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Calls that compile kernels on a device, each by its name."""
    import numpy as np
    import torch

    import sdm
    from sdm.core.demo_mesh import demo_mesh

    closed = demo_mesh(rings=41, segments=16, cap_rings=3)
    # A hole: signs by winding numbers take kernels of their own.
    opened = sdm.TriangleMesh(closed.vertices, closed.faces[7:], check=False)
    points = np.zeros((300, 3), np.float32)
    mask = torch.zeros((12, 12, 12), dtype=torch.bool, device=device)
    mask[4:8, 4:8, 4:8] = True
    grid = sdm.Grid.around(closed, resolution=RESOLUTION)
    where: Any = {"device": device}
    yield "maps of closed meshes", lambda: sdm.signed_distance_map(closed, grid, **where).values
    yield "maps of open meshes", lambda: sdm.signed_distance_map(opened, grid, **where).values
    yield "signs by a flood", lambda: sdm.signed_distance_map(opened, grid, sign="flood", **where).values
    yield "points", lambda: sdm.signed_distance(closed, points, **where)
    yield "points of open meshes", lambda: sdm.signed_distance(opened, points, **where)
    yield "narrow bands", lambda: sdm.narrow_band(closed, grid, **where).to_mesh()
    yield "lists of meshes", lambda: sdm.signed_distance_maps([closed, opened], grid, **where)
    yield "distance transforms", lambda: sdm.euclidean_distance_transform(mask, signed=True)


def compile_ahead(device: str, say: Callable[[str, int, int], None]) -> None:
    """Run all of it; `say(name, done, total)` hears of each before it begins, and at the end."""
    import torch

    work = list(steps(device))
    for number, (name, call) in enumerate(work):
        say(name, number, len(work))
        with warnings.catch_warnings():
            # What is odd about these meshes is meant.
            warnings.simplefilter("ignore", SDMWarning)
            call()
        if device.startswith("cuda"):
            torch.cuda.synchronize(device)
    say("done", len(work), len(work))
