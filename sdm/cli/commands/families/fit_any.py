"""`sdm fit` of any family, or of a DeepSDF: to an image, or to points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.cli.fits.fit_report import FitFiles
    from sdm.fit.model.backend import Backend

# Mean distance of points from a shape, as a share of their extent, from which on it has nothing of them.
HOPELESS = 0.1


def fit_any_family(
    image: Path,
    name: str,
    files: FitFiles,
    given: dict[str, Any],
    triangles: int | None,
    device: str,
    *,
    with_blur: bool = False,
    with_formation: bool = False,
    mirror: bool = False,
) -> None:
    """Fit a family to an image, and write files.

    Args:
        image: The image's file.
        name: The family, as every command takes it, or a DeepSDF's file.
        files: To write.
        given: Options of `FitOptions`; those that are None count as not given.
        triangles: Of the family's meshes, where that can be chosen.
        device: Where.
        with_blur: Estimate the blur with the shape.
        with_formation: Estimate the image's formation with the shape.
        mirror: Fit mirror images of the family's shapes.
    """
    import sdm
    from sdm.cli.fits.fit_progress import FitProgress
    from sdm.cli.fits.fit_report import write_fit
    from sdm.fit.solve.fit_family import fit_scaled, usual_options

    if is_network(name):
        from sdm.cli.commands.families.fit_network import fit_network

        refuse_mesh_options(name, triangles, mirror)
        fit_network(image, name, files, given, device, with_blur=with_blur, with_formation=with_formation)
        return
    fitted = shapes_to_fit(name, triangles, device, mirror=mirror)
    scan = sdm.load(image)
    options = usual_options(scan.grid, fitted.factor, **given)
    with FitProgress(image, scan, options) as progress:
        result = fit_scaled(
            scan.values,
            scan.grid,
            fitted.backend(fitted.factor),
            fitted.factor,
            options=options,
            with_blur=with_blur,
            with_formation=with_formation,
            report=progress,
        )
    write_fit(files, scan, fitted.backend(1.0), result, blur=options.blur, unit=fitted.unit)


@dataclass(frozen=True)
class ShapesToFit:
    """Shapes that a fit chooses among.

    Args:
        backend: Their distances, in lengths that are so many times theirs.
        factor: At which fits work.
        unit: Of their lengths, or nothing.
    """

    backend: Callable[[float], Backend]
    factor: float
    unit: str


def is_network(name: str) -> bool:
    """True of the name of a DeepSDF: MODEL.pt, or the folder that a training left it in."""
    return name.lower().endswith(".pt") or (Path(name) / "model.pt").is_file()


def refuse_mesh_options(name: str, triangles: int | None, mirror: bool) -> None:
    """Refuse what a DeepSDF has no meshes for.

    Raises:
        SDMError: One of these is given.
    """
    from sdm.errors import SDMError

    if triangles is not None or mirror:
        raise SDMError(f"{name} is a DeepSDF: --triangles and --mirror are for families of meshes")


def shapes_to_fit(name: str, triangles: int | None, device: str, *, mirror: bool = False) -> ShapesToFit:
    """Shapes by the name of a family."""
    from sdm.fit import ExactBackend
    from sdm.fit.model.scaled_family import MirroredFamily, ScaledFamily, factor_of
    from sdm.shapes import load_family

    family = load_family(name, triangles=triangles)
    family = MirroredFamily(family) if mirror else family
    return ShapesToFit(
        lambda factor: ExactBackend(family if factor == 1 else ScaledFamily(family, factor), device),
        factor_of(family),
        _unit(family),
    )


def fit_family_points(
    points: Path, name: str, out: Path, mesh: Path | None, turn: float, triangles: int | None, device: str
) -> None:
    """Fit a family, or a DeepSDF, to points of a file, and write report and surface."""
    import numpy as np

    from sdm.cli.common.progress import StageProgress
    from sdm.cli.fits.fit_report import NOT_CONVERGED, print_points
    from sdm.cli.fits.points_file import points_of
    from sdm.errors import SDMError
    from sdm.fit.solve.fit_points import fit_points
    from sdm.io.files.json_file import write_json
    from sdm.io.meshes.write import save_mesh
    from sdm.viz.fit_figure import surface_at

    found, _ = points_of(points)
    if is_network(name):
        from sdm.cli.commands.families.fit_network import fit_network_points

        refuse_mesh_options(name, triangles, False)
        fit_network_points(found, points, name, out, mesh, turn, device)
        return
    fitted = shapes_to_fit(name, triangles, device)
    backend = fitted.backend(1.0)
    with StageProgress() as progress:
        fit = fit_points(found, backend, turn=turn, report=progress)
    record = {**fit.record(backend.parameters), "points": len(found)}
    write_json(out, record)
    if not fit.converged:
        raise SDMError(f"{NOT_CONVERGED}: {points} may be no shape of this family, or turned further (--turn)")
    across = float(np.ptp(np.asarray(found, dtype=np.float64), axis=0).max())
    if fit.mean_distance > HOPELESS * across:
        raise SDMError(
            f"the fit gives no answer: the points are {across:.3g} across, and the shape is {fit.mean_distance:.3g} "
            f"from them on average: {points} may be no shape of this family, or in another unit"
        )
    state = fit.posterior.state
    if mesh is not None:
        save_mesh(surface_at(backend, state), mesh)
    print_points(record, state, len(found), fit.mean_distance, fitted.unit)


def _unit(family: Any) -> str:
    lengths = {p.unit for p in family.parameters} & {"mm", "cm", "m"}
    return lengths.pop() if len(lengths) == 1 else ""
