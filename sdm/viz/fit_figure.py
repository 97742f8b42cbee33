"""A fit as a surface, and as a picture to check by eye."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.given_values import as_path
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError
from sdm.fit.model.backend import Backend, HasSurface
from sdm.fit.model.jacobian import vertices_of, vertices_with_jacobian
from sdm.fit.model.pose import State
from sdm.fit.solve.result import FitResult, vertex_normals
from sdm.io.files.atomic import replacing
from sdm.shapes import Family, make_family
from sdm.viz.style import OCHRE, STYLE, SURFACE_LINE, colour_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf", "svg")
# Estimates that a panel has room for.
MOST_LINES = 14


def surface_of(backend: Backend, result: FitResult) -> TriangleMesh:
    """The fitted surface in the world's coordinates: the backend's own mesh, or a cochlea's."""
    return surface_at(backend, result.state)


def surface_at(backend: Backend, state: State) -> TriangleMesh:
    """The surface of a state in the world's coordinates."""
    if isinstance(backend, HasSurface):
        own = backend.surface_mesh(state.theta)
        vertices, faces = own.vertices, own.faces
    else:
        family = _family_of(backend)
        vertices, faces = vertices_of(family, state.theta), family.faces
    return TriangleMesh(state.to_world(vertices.to(state.theta)).float().cpu(), faces.cpu(), "fit", check=False)


def surface_deviations(backend: Backend, result: FitResult) -> Tensor:
    """(V,) standard deviation [mm] of the surface along its normal at each vertex of `surface_of`."""
    theta = result.state.theta
    if isinstance(backend, HasSurface):
        vertices = backend.surface_mesh(theta).vertices.to(theta)
        found = backend.with_derivatives(theta, vertices)
        # A surface goes outward by as much as the distance at its points falls.
        jacobian = -found.by_point[:, :, None] * found.by_theta[:, None]
        return result.posterior.surface_deviation(vertices, jacobian, found.by_point)
    family = _family_of(backend)
    vertices, jacobian = vertices_with_jacobian(family, theta)
    normals = vertex_normals(vertices, family.faces_on(theta.device).to(torch.int64))
    return result.posterior.surface_deviation(vertices, jacobian, normals)


def draw_fit(
    image: Tensor,
    grid: Grid,
    backend: Backend,
    result: FitResult,
    path: str | Path,
    *,
    title: str = "Fit to the image",
    unit: str = "mm",
) -> None:
    """Draw the image's three middle slices with the fitted outline, what is left over, and the estimates.

    Args:
        image: (nx,ny,nz) intensities.
        grid: Where its voxels are.
        backend: Of the fit, in the image's unit.
        result: The fit.
        path: Where to.
        title: Above.
        unit: Of lengths, or nothing.

    Raises:
        FormatError: An ending that is not known, or a place that cannot be written.
    """
    target = as_path(path)
    kind = target.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise FormatError(f"{target} does not end like a picture: use one of .{', .'.join(FORMATS)}")
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = _figure(image, grid, backend, result, title, unit)
        with replacing(target) as part:
            figure.savefig(part, format=kind, dpi=110)


def _figure(image: Tensor, grid: Grid, backend: Backend, result: FitResult, title: str, unit: str) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.3, 7.5), facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=18, fontweight="bold", x=0.03, ha="left")
    places = {"left": 0.03, "right": 0.99, "top": 0.88, "bottom": 0.03, "wspace": 0.06, "hspace": 0.12}
    axes = figure.subplots(2, 4, gridspec_kw=places)
    values, share = image.double().cpu().numpy(), result.share.cpu().numpy()
    left = values - result.expected.double().cpu().numpy()
    limits, spread = np.percentile(values, [0.5, 99.5]), 3 * float(left.std()) or 1.0
    inside = np.argwhere(share > 0.5)
    middle = inside.mean(0).round().astype(int) if len(inside) else np.array(values.shape) // 2
    for column, normal in enumerate((2, 1, 0)):
        up, right = (axis for axis in (2, 1, 0) if axis != normal)
        for row, (shown, colours, low, high) in enumerate(
            ((values, "gray", *limits), (left, colour_map().reversed(), -spread, spread))
        ):
            panel = axes[row, column]
            cut, outline = (np.take(a, middle[normal], axis=normal).T for a in (shown, share))
            panel.imshow(cut, cmap=colours, vmin=low, vmax=high, origin="lower", interpolation="none",
                         aspect=grid.spacing[up] / grid.spacing[right])  # fmt: skip
            if outline.min() < 0.5 < outline.max():
                panel.contour(outline, levels=[0.5], colors=OCHRE, linewidths=SURFACE_LINE)
            panel.set_title(f"{'image' if row == 0 else 'left over'}, {'xyz'[normal]} slice", fontsize=10)
            panel.set_xticks([])
            panel.set_yticks([])
    _list(axes[0, 3], _estimates(result))
    if result.diagnosis.warnings:
        sure = "intervals may be off: see the report's warnings"
    else:
        sure = f"surface within {float(surface_deviations(backend, result).mean()):.4g} {unit}".rstrip() + " (1 sd)"
    _list(axes[1, 3], [sure,
                       f"explains {result.diagnosis.explained:.1%} of its neighbourhood",
                       f"contrast {result.diagnosis.contrast:.1f} times the noise",
                       f"{sum(result.evaluations.values())} shape evaluations, {result.seconds:.1f} s"])  # fmt: skip
    return figure


def _estimates(result: FitResult) -> list[str]:
    ends = result.posterior.intervals(0.9)[: len(result.parameters)].tolist()
    lines = ["estimate and 90 % interval"]
    for parameter, value, (low, high) in zip(result.parameters, result.state.theta.tolist(), ends, strict=True):
        unit = "" if parameter.unit in ("1", "length") else f" {parameter.unit}"
        lines.append(f"{parameter.name} = {value:.4f} ({low:.4f} to {high:.4f}){unit}")
    if len(lines) > MOST_LINES:
        lines[MOST_LINES - 1 :] = [f"and {len(lines) - MOST_LINES + 1} more: see the report"]
    return lines


def _list(panel: Any, lines: list[str]) -> None:
    panel.axis("off")
    pitch = min(0.11, 1.0 / len(lines))
    for row, line in enumerate(lines):
        panel.text(0.0, 0.9 - pitch * row, line, fontsize=10, transform=panel.transAxes)


def _family_of(backend: Backend) -> Family:
    return getattr(backend, "family", None) or make_family("cochlea")
