"""Progress of a fit to an image, and a notice where the image is much larger than the shape in it."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

import torch

from sdm.cli.common.printed_line import print_line
from sdm.cli.common.progress import StageProgress
from sdm.core.signed_distance_map import SDM

if TYPE_CHECKING:
    from sdm.fit import FitOptions

# Sample points from which on a fit is slow: an image of one cochlea and a little around has some 300,000.
MANY_POINTS = 4_000_000
# Steps of most fits to the image itself, after those to a coarse one.
USUAL_STEPS = "10 to 20"


class FitProgress(StageProgress):
    """Progress of a fit, to be called with each step.

    Of an image with very many sample points it says on stderr how large it is and what to crop, and once steps are
    timed about how long the fit takes.

    Args:
        image: The image's file.
        scan: The image.
        options: Of the fit, with lengths in the image's unit.
    """

    def __init__(self, image: Path, scan: SDM, options: FitOptions) -> None:
        super().__init__()
        self._notice = size_notice(scan, math.inf if options.model == "labels" else options.fine)
        self._name = image.name
        # When the first step to the image itself was done.
        self._first: float | None = None

    def __enter__(self) -> Self:
        if self._notice is not None:
            print_line(f"sdm: {self._name}: {self._notice}", error=True)
        self.draw("start", 0, None)
        return super().__enter__()

    def __call__(self, stage: str, step: int, *more: object) -> None:
        """A stage's step, by number."""
        super().__call__(stage, step, *more)
        if self._notice is None or stage == "start":
            return
        if self._first is None:
            self._first = time.monotonic()
        elif step == 2:
            seconds = time.monotonic() - self._first
            self._notice = None
            print_line(
                f"sdm: {self._name}: a step takes about {seconds:.2g} s, and most fits {USUAL_STEPS} of them",
                error=True,
            )


def size_notice(scan: SDM, fine: float) -> str | None:
    """A sentence about an image whose fit takes long: how large it is, and what to crop; None for others.

    Args:
        scan: The image.
        fine: Largest distance between sample points in its unit; infinite for one point a voxel.
    """
    points = scan.grid.size * math.prod(max(1, math.ceil(s / fine - 1e-9)) for s in scan.grid.spacing)
    if points < MANY_POINTS:
        return None
    where = _foreground(scan.values)
    crop = "the shape" if where is None else f"voxels {where}, which alone differ from {float(scan.values[0, 0, 0]):g},"
    return (
        f"{scan.grid.summary} are {points / 1e6:,.0f} million sample points, which take long and much memory: crop it "
        f"to {crop} and a few voxels around"
    )


def _foreground(values: torch.Tensor) -> str | None:
    """The box, as "5 to 9, 4 to 8, ..." along each axis, of voxels unlike all corners; None if it is most of them."""
    corners = values[:: max(1, len(values) - 1)][:, :: max(1, values.shape[1] - 1), :: max(1, values.shape[2] - 1)]
    if not bool((corners == corners[0, 0, 0]).all()):
        return None
    other = values != corners[0, 0, 0]
    ends: list[tuple[int, int]] = []
    for axis in range(3):
        there = other.sum([a for a in range(3) if a != axis]).nonzero()
        if not len(there):
            return None
        ends.append((int(there[0]), int(there[-1])))
    if 2 * math.prod(last - first + 1 for first, last in ends) > values.numel():
        return None
    return ", ".join(f"{first} to {last}" for first, last in ends)
