"""Files that a fit leaves, and its estimates on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdm.cli.common.printed_line import print_line
from sdm.cli.common.progress import StageProgress
from sdm.io.files.json_file import write_json

if TYPE_CHECKING:
    import torch

    from sdm.core.mesh import TriangleMesh
    from sdm.fit import FitResult
    from sdm.fit.model.backend import Backend

NOT_CONVERGED = "the fit did not converge"


@dataclass(frozen=True)
class FitFiles:
    """Files that are asked for; None where one is not.

    Args:
        report: JSON.
        mesh: The surface.
        picture: The image with the outline.
        residuals: The image less what the fit expects.
        free_form: The surface whose vertices went on freely.
    """

    report: Path
    mesh: Path | None = None
    picture: Path | None = None
    residuals: Path | None = None
    free_form: Path | None = None


def write_fit(
    files: FitFiles,
    scan: Any,
    backend: Backend,
    result: FitResult,
    *,
    blur: float,
    unit: str = "mm",
    record: dict[str, Any] | None = None,
    surface: Callable[[], TriangleMesh] | None = None,
) -> None:
    """Write a fit's files, and print its estimates.

    Args:
        files: Where.
        scan: The image, with its grid.
        backend: Of the shape, in the image's unit.
        result: The fit.
        blur: That it took for granted.
        unit: Of lengths.
        record: The report's content, if not the result's own.
        surface: Makes the fitted surface, if it is not the backend's own; only where a file needs it.

    Raises:
        FitError: The fit is not to be trusted. Report, residuals and free form are written.
    """
    from sdm.io.meshes.write import save_mesh
    from sdm.viz.fit_figure import draw_fit, surface_of

    made = cache(partial(surface_of, backend, result) if surface is None else surface)
    write_json(files.report, result.record() if record is None else record)
    save_residuals(scan, result, files.residuals)
    save_free_form(scan, backend.device, result, blur, files.free_form, made)
    result.require()
    if files.mesh is not None:
        save_mesh(made(), files.mesh)
    if files.picture is not None:
        draw_fit(scan.values, scan.grid, backend, result, files.picture, unit=unit)
    print_fit(result, blur, unit)


def print_fit(result: FitResult, blur: float, unit_of_length: str = "mm") -> None:
    """Print estimates with their intervals, and what they take for granted."""
    ends = result.posterior.intervals(0.9).tolist()
    for parameter, value, (low, high) in zip(result.parameters, result.state.theta.tolist(), ends, strict=False):
        unit = "" if parameter.unit in ("1", "length") else f" {parameter.unit}"
        print(f"{parameter.name:<6} {value:.4f}{unit}, 90 % within {low:.4f} to {high:.4f}")
    place = ", ".join(f"{x:.3f}" for x in result.state.translation.tolist())
    print(f"centre {place} {unit_of_length}".rstrip())
    diagnosis = result.diagnosis
    print(f"explains {diagnosis.explained:.1%} of its neighbourhood, contrast {diagnosis.contrast:.1f} times the noise")
    evaluations = ", ".join(f"{count} ({name})" for name, count in result.evaluations.items())
    print(f"shape evaluations: {evaluations}; {result.seconds:.1f} s")
    # Coverage where that is not so: sdm/fit/README.md, "Limits".
    if result.formation is not None:
        found, share = result.formation, result.formation.effective_share
        print(f"blur   {found.blur[0]:.4f}, standard deviation {found.blur[1]:.4f}")
        print(
            f"noise  counts {share:.0%} of the voxels; what the residuals at the surface say: p = {found.p_value:.2g}"
        )
        print("intervals take for granted voxels that mix inside and outside, and that the family holds the shape")
        for sentence in diagnosis.warnings:
            print(f"sdm: {sentence}", file=sys.stderr)
        return
    granted = f"a blur of {f'{blur:g} {unit_of_length}'.rstrip()} (--blur), "
    if result.blur is not None:
        granted = ""
        print(f"blur   {result.blur[0]:.4f}, standard deviation {result.blur[1]:.4f}")
    print(
        f"intervals take for granted {granted}white noise, even intensities and voxels "
        "that mix inside and outside; where one of these does not hold they are too narrow"
    )
    for sentence in diagnosis.warnings:
        print(f"sdm: {sentence}", file=sys.stderr)


def save_residuals(scan: Any, result: FitResult, path: Path | None) -> None:
    """Write the image less what the fit expects, where a file for it is named."""
    import sdm

    if path is not None:
        left = scan.values.double().cpu() - result.expected.cpu()
        sdm.save(sdm.SDM(left.float(), scan.grid), path)


def save_free_form(
    scan: Any,
    device: torch.device,
    result: FitResult,
    blur: float,
    path: Path | None,
    start: Callable[[], TriangleMesh],
) -> None:
    """Write the fitted surface with its free-form remainder, where a file for it is named and a shape was found.

    Vertices go on from those of `start`.
    """
    if path is None or result.diagnosis.hopeless:
        return
    from sdm.fit.solve.free_form import free_form
    from sdm.io.meshes.write import save_mesh

    own = blur if result.blur is None else result.blur[0]
    with StageProgress() as progress:
        found = free_form(scan.values, scan.grid, start(), blur=own, device=device, report=progress)
    save_mesh(found.mesh, path)
    print_line(f"free   vertices moved {found.moved:.3g} (root mean square), free of the family: {path}")


def print_points(record: dict[str, Any], state: Any, count: int, distance: float, unit: str) -> None:
    """Print estimates of points with their intervals."""
    for key, value in record["theta"].items():
        low, high = value["interval"]
        print(f"{key:<6} {value['estimate']:.4f}, 90 % within {low:.4f} to {high:.4f}")
    print(f"centre {', '.join(f'{x:.3f}' for x in state.translation.tolist())} {unit}".rstrip())
    print(
        f"{count:,} points, {distance:.4g} {unit}".rstrip() + " from the shape on average; intervals take "
        "them to be independent"
    )
    for sentence in record["warnings"]:
        print_line(f"sdm: {sentence}", error=True)
