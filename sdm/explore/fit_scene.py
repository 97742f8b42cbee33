"""The fit of a family to an image, step by step, while it is computed."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from sdm.core.signed_distance_map import SDM
from sdm.errors import SDMError
from sdm.explore.controls import Control, Shown, Slider, Switch, Values
from sdm.fit.model.pose import State
from sdm.fit.model.scaled_family import factor_of
from sdm.fit.solve.fit_family import fit_family
from sdm.fit.solve.fit_shape import FitOptions
from sdm.fit.solve.result import FitResult
from sdm.fit.solve.solver import Point
from sdm.shapes import Family
from sdm.shapes.registry import families

FOLLOW, STEP = "follow the fit", "step"
# End of the slider: most fits take a dozen steps.
MOST_STEPS = 40
# Seconds between looks for a new step.
PAUSE = 0.1
COCHLEA = "cochlea"


class _EndedError(Exception):
    """The page is gone."""


class _EndableFamily(Family):
    """The shapes of a family, until the page is gone: a fit asks for shapes far more often than it reports steps."""

    def __init__(self, family: Family, gone: threading.Event) -> None:
        self.family, self.gone = family, gone
        self.parameters, self.triangles = family.parameters, family.triangles
        # As an own attribute: errors name the family.
        vars(self)["name"] = family.name

    def vertices(self, theta: torch.Tensor) -> torch.Tensor:
        """Vertices (B,V,3) for theta (B,P)."""
        self._check()
        return self.family.vertices(theta)

    def reference_vertices(self, theta: torch.Tensor) -> torch.Tensor:
        """Vertices (B,V,3) in theta's own type."""
        self._check()
        return self.family.reference_vertices(theta)

    def with_triangles(self, triangles: int) -> Family | None:
        """The same from meshes of about so many triangles; None where that is no matter of choice."""
        other = self.family.with_triangles(triangles)
        return None if other is None else _EndableFamily(other, self.gone)

    def _check(self) -> None:
        if self.gone.is_set():
            raise _EndedError


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step of the fit.

    Args:
        name: Stage and number.
        vertices: (V,3) float32 of the surface, in the world.
        share: (nx,ny,nz) share of inside of each voxel.
        objective: Minus the log posterior density, but for a constant.
    """

    name: str
    vertices: np.ndarray
    share: torch.Tensor
    objective: float


class FitScene:
    """An image, and the surface of the newest step.

    Args:
        title: The image's name.
        image: Cropped to the shape and a little around, in the family's unit.
        family: Any family that `fit_family` takes.
        device: Where the fit is computed.
    """

    def __init__(self, title: str, image: SDM, family: Family, device: torch.device) -> None:
        self.title, self.image, self.family, self.device = f"{family.name} in {title}", image.cpu(), family, device
        self.controls: Sequence[Control] = (Switch(FOLLOW, start=True), Slider(STEP, 1, MOST_STEPS, 1, 1))
        low, high = np.percentile(self.image.numpy(), [0.5, 99.5])
        self._centre, self._limit = float(low + high) / 2, max(float(high - low) / 2, 1e-12)
        self._factor = factor_of(family)
        self.steps: list[Step] = []
        self.result: FitResult | None = None
        self.problem = ""
        self._seen, self._changes, self._gone = 0, 0, threading.Event()
        self._thread: threading.Thread | None = None

    def pause(self, values: Values) -> float | None:
        """Seconds between looks for a new step; None once all of them were shown."""
        del values
        return PAUSE if self._running or self._seen != self._changes else None

    def step(self, values: Values) -> bool:
        """True if there is a new step to show."""
        del values
        new = self._seen != self._changes
        self._seen = self._changes
        return new

    def close(self) -> None:
        """End the fit at the next shape that it asks for."""
        self._gone.set()
        if self._thread is not None:
            self._thread.join()

    def show(self, values: Values) -> Shown:
        """The newest step, or the one that the slider says. The first call begins the fit."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._fit, name="fit", daemon=True)
            self._thread.start()
        steps = list(self.steps)
        vertices, faces = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
        outline, note = None, "the fit looks for a place to start from"
        if steps:
            number = len(steps) if values[FOLLOW] else min(int(values[STEP]), len(steps))
            step = steps[number - 1]
            so_far = " so far" if self._running else ""
            vertices, faces = step.vertices, self.family.faces.numpy()
            outline = self.image.with_values(0.5 - step.share)
            note = f"step {number} of {len(steps)}{so_far}: {step.name}, objective {step.objective:,.1f}"
        if self.problem:
            note = f"{note}\n\n{self.problem}"
        elif self.result is not None:
            note = f"{note}\n\n{self._estimates(self.result)}"
        return Shown(
            vertices,
            faces,
            self.image,
            note,
            quantity="intensity",
            scale_end=self._limit,
            centre=self._centre,
            outline=outline if outline is not None else self.image.with_values(torch.ones(self.image.grid.shape)),
            grey=True,
        )

    @property
    def _running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _estimates(self, result: FitResult) -> str:
        ends = result.posterior.intervals(0.9).tolist()
        lines = [
            f"- {p.name} = {value:.4g}{'' if p.unit == '1' else f' {p.unit}'}, 90 % within {low:.4g} to {high:.4g}"
            for p, value, (low, high) in zip(result.parameters, result.state.theta.tolist(), ends, strict=False)
        ]
        return "\n".join([f"done in {result.seconds:.1f} s:\n", *lines])

    def _fit(self) -> None:
        # Of a cochlea as `sdm fit` does it.
        options = FitOptions() if type(self.family) is families[COCHLEA] else None
        try:
            found = fit_family(
                self.image.values,
                self.image.grid,
                _EndableFamily(self.family, self._gone),
                options=options,
                device=self.device,
                report=self._note,
            )
            self.result = found.require()
        except SDMError as error:
            self.problem = str(error)
        except _EndedError:
            return
        self._changes += 1

    def _note(self, stage: str, number: int, point: Point | None) -> None:
        # The search for a place to begin goes through places, in a coarse image, that have no outline in this one.
        if point is None or stage == "start":
            return
        state = point.state
        own = State(state.theta, state.rotation, state.translation / self._factor, state.centre / self._factor)
        with torch.no_grad():
            vertices = self.family.vertices(state.theta.float()[None])[0]
            vertices = own.to_world(vertices.double()).float().cpu().numpy()
        share = point.share.float().cpu().reshape(self.image.grid.shape)
        self.steps.append(Step(f"{stage} {number}", vertices, share, point.objective))
        self._changes += 1
