"""Shapes of a family, by sliders of its parameters: exact, or by a surrogate and coloured by its error."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError
from sdm.explore.controls import Choice, Control, Shown, Slider, Switch, Values
from sdm.explore.cutting_plane import coloured
from sdm.explore.planes import ComputedPlanes
from sdm.runtime.threads import threads
from sdm.shapes import Family

SURROGATE, EXACT = "surrogate", "exact engine"
METHOD, ERROR = "map by", "error of the surrogate"
# A network's errors beyond this many voxels have the colour of this many.
ERROR_END_VOXELS = 0.5


class FamilyScene:
    """A family's shapes.

    Args:
        family: Any family.
        resolution: Voxels along each axis of the exact engine's map; the surrogate has a grid of its own.
        device: Where the exact engine computes.
        predictor: A surrogate of the family, with `predict(theta) -> SDM`; None if there is none.

    The exact engine measures the plane that is shown alone, as the family's own mesh is the surface.
    """

    def __init__(self, family: Family, resolution: int, device: torch.device, predictor: Any = None) -> None:
        if not family.parameters:
            raise MeshError(f"{family.name} has no parameters to explore; give one of its meshes")
        self.family, self.device = family, device
        self.predictor: Any = predictor
        self.title = family.name
        self.grid: Grid = family.grid(resolution)
        self.labels = [p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in family.parameters]
        controls: list[Control] = [
            Slider(label, _brief(p.low), _brief(p.high), _brief((p.high - p.low) / 200), _brief((p.low + p.high) / 2))
            for label, p in zip(self.labels, family.parameters, strict=True)
            if p.low < p.high
        ]
        if predictor is not None:
            controls += [Choice(METHOD, (SURROGATE, EXACT)), Switch(ERROR)]
        self.controls = controls

    def theta(self, values: Values) -> torch.Tensor:
        """Parameters (P,) float32 that sliders say, within the family's box."""
        numbers = [
            min(max(float(values.get(label, p.low)), p.low), p.high)
            for label, p in zip(self.labels, self.family.parameters, strict=True)
        ]
        return torch.tensor(numbers, dtype=torch.float32, device="cpu")

    def show(self, values: Values) -> Shown:
        """The shape of these parameters."""
        theta = self.theta(values)
        if self.predictor is not None and values.get(ERROR):
            return self._with_error(theta)
        if self.predictor is None or values.get(METHOD, SURROGATE) == EXACT:
            return self._exact(theta)
        field = self._predict(theta)
        surface = field.to_mesh()
        vertices, faces = surface.vertices.cpu().numpy(), surface.faces.cpu().numpy()
        return Shown(vertices, faces, field.cpu(), self._said(SURROGATE, field.grid, vertices, faces))

    def _predict(self, theta: torch.Tensor) -> SDM:
        # A small network: more threads would mostly wait for each other, and the browser wants a core too.
        with threads(1):
            return self.predictor.predict(theta)

    def _exact(self, theta: torch.Tensor) -> Shown:
        with torch.no_grad():
            mesh = self.family.mesh(theta.to(self.device))
        index = MeshIndex(mesh, device=self.device)
        planes = ComputedPlanes(self.grid, index.signed_distance_map)
        vertices, faces = mesh.vertices.cpu().numpy(), mesh.faces.cpu().numpy()
        return Shown(vertices, faces, planes, self._said(EXACT, self.grid, vertices, faces))

    def _said(self, how: str, grid: Grid, vertices: np.ndarray, faces: np.ndarray) -> str:
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        volume = float((a * np.cross(b, c)).sum(dtype=np.float64)) / 6
        units = {p.unit for p in self.family.parameters} & {"mm", "cm", "m", "um"}
        unit = f" {units.pop()}³" if len(units) == 1 else ""
        size = "×".join(map(str, grid.shape))
        return f"{how}, {size} voxels, {len(faces):,} triangles, volume {volume:.4g}{unit}"

    def _with_error(self, theta: torch.Tensor) -> Shown:
        """The exact surface, coloured by the surrogate's distance there, which should be 0."""
        mesh = self.family.mesh(theta)
        field = self._predict(theta)
        error = field.sample(mesh.vertices).numpy()
        end = ERROR_END_VOXELS * max(field.grid.spacing)
        unit = self.family.parameters[0].unit if self.family.parameters else "1"
        unit = "" if unit in ("1", "rad") else f" {unit}"
        note = (
            f"error of the surrogate on the exact surface: {np.abs(error).mean():.3f}{unit} on average, "
            f"{np.abs(error).max():.3f}{unit} at most; blue: its surface lies inside the exact one, red: outside; "
            f"full colour at {end:.2g}{unit}"
        )
        return Shown(mesh.vertices.numpy(), mesh.faces.numpy(), field, note, colours=coloured(error / end))


def _brief(number: float) -> float:
    """Three digits, for the ends of a slider; `theta` keeps within the box."""
    return float(f"{number:.3g}")
