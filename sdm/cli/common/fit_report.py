"""Report of a fit to an image: estimates on the terminal, and residuals as an image."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.core.mesh import TriangleMesh
    from sdm.fit import FitResult
    from sdm.fit.model.backend import Backend


def print_fit(result: FitResult, blur: float, unit_of_length: str = "mm") -> None:
    """Print estimates with their intervals, and what they take for granted."""
    ends = result.posterior.intervals(0.9).tolist()
    for parameter, value, (low, high) in zip(result.parameters, result.state.theta.tolist(), ends, strict=False):
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
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
    scan: Any, backend: Backend, result: FitResult, blur: float, path: Path | None, surface: TriangleMesh | None = None
) -> None:
    """Write the fitted surface with its free-form remainder, where a file for it is named and a shape was found.

    Vertices go on from `surface`, or from the backend's.
    """
    if path is None or result.diagnosis.hopeless:
        return
    from sdm.fit.solve.free_form import free_form
    from sdm.io.meshes.write import save_mesh
    from sdm.viz.fit_figure import surface_of

    own = blur if result.blur is None else result.blur[0]
    start = surface_of(backend, result) if surface is None else surface
    found = free_form(scan.values, scan.grid, start, blur=own, device=backend.device)
    save_mesh(found.mesh, path)
    print(f"free   vertices moved {found.moved:.3g} (root mean square), free of the family: {path}")
