"""A training stream as it comes: one fresh sample after another, with its parameters and its number."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

import torch

from sdm.core.signed_distance_map import SDM
from sdm.explore.controls import Control, Shown, Slider, Switch, Values
from sdm.shapes import Family
from sdm.stream import SDMStream

RUN, PACE = "run", "samples a second"


class StreamScene:
    """The samples that a network would be trained on.

    Args:
        family: Any family.
        resolution: Voxels along each axis.
        device: Where the stream makes its batches.
        seed: Of the stream: sample n of a seed is the same wherever it is made.
        batch_size: Samples of a batch.
    """

    def __init__(
        self, family: Family, resolution: int, device: torch.device, seed: int = 0, batch_size: int = 4
    ) -> None:
        self.family, self.title = family, f"stream of {family.name}, seed {seed}"
        self.stream = SDMStream(
            family, family.grid(resolution), batch_size, seed, rank=0, world_size=1, device=device, prefetch=1
        )
        self.controls: Sequence[Control] = (Switch(RUN, start=True), Slider(PACE, 0.5, 20.0, 0.5, 2.0))
        self._batches = iter(self.stream)
        self._ready: deque[tuple[int, torch.Tensor, torch.Tensor]] = deque()
        self._seconds = 0.0
        self.number, self.theta, self.field = self._next()

    def pause(self, values: Values) -> float | None:
        """Seconds between samples."""
        return 1 / float(values[PACE]) if values[RUN] else None

    def step(self, values: Values) -> bool:
        """The next sample."""
        del values
        self.number, self.theta, self.field = self._next()
        return True

    def close(self) -> None:
        """End the stream."""
        close = getattr(self._batches, "close", None)
        if close is not None:
            close()

    def show(self, values: Values) -> Shown:
        """The sample that came last."""
        del values
        surface = self.field.to_mesh()
        said = ", ".join(
            f"{p.name} = {value:.3g}{'' if p.unit == '1' else f' {p.unit}'}"
            for p, value in zip(self.family.parameters, self.theta.tolist(), strict=True)
        )
        size = "×".join(map(str, self.field.grid.shape))
        note = (
            f"sample {self.number:,}: {said}\n\n{size} voxels, {len(surface.faces):,} triangles; the last batch of "
            f"{self.stream.batch_size} took {self._seconds:.2g} s on {self.stream.device.type}"
        )
        return Shown(surface.vertices.numpy(), surface.faces.numpy(), self.field, note)

    def _next(self) -> tuple[int, torch.Tensor, SDM]:
        if not self._ready:
            begin = time.perf_counter()
            batch = next(self._batches)
            theta, maps = batch.theta.cpu(), batch.sdm[:, 0].cpu()
            self._seconds = time.perf_counter() - begin
            self._ready.extend(zip(batch.index.tolist(), theta, maps, strict=True))
        number, theta, values = self._ready.popleft()
        return number, theta, SDM(values, self.stream.grid)
