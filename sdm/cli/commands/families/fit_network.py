"""`sdm fit` of a DeepSDF: to an image, or to points."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.cli.fits.fit_report import FitFiles


def fit_network(
    image: Path,
    name: str,
    files: FitFiles,
    given: dict[str, Any],
    device: str,
    *,
    with_blur: bool = False,
    with_formation: bool = False,
) -> None:
    """Fit a DeepSDF to an image, and write files; the arguments are those of `fit_any_family`."""
    import sdm
    from sdm.cli.fits.fit_progress import FitProgress
    from sdm.cli.fits.fit_report import write_fit
    from sdm.deepsdf import DeepSDF
    from sdm.deepsdf.infer.fit_backend import DeepSDFBackend, factor_of_model
    from sdm.deepsdf.infer.fit_deepsdf import fit_deepsdf
    from sdm.fit.solve.fit_family import usual_options

    model = DeepSDF.load(name, device)
    scan = sdm.load(image)
    options = usual_options(scan.grid, factor_of_model(model), **given)
    with FitProgress(image, scan, options) as progress:
        fit = fit_deepsdf(
            scan.values,
            scan.grid,
            model,
            options=options,
            with_blur=with_blur,
            with_formation=with_formation,
            report=progress,
        )
    backend = DeepSDFBackend(model)
    surface = None if fit.code is None else partial(fit.code.mesh, backend)
    record = fit.record()
    write_fit(files, scan, backend, fit.result, blur=options.blur, unit="", record=record, surface=surface)
    if fit.code is not None:
        size = float(fit.code.state.theta[0])
        print(f"code   all {len(fit.code.code):,} numbers, size {size:.4g}: the surface is of these, without intervals")


def fit_network_points(
    found: Any, points: Path, name: str, out: Path, mesh: Path | None, turn: float, device: str
) -> None:
    """Fit a DeepSDF to points (N,3) of a file, and write report and surface."""
    from sdm.cli.common.progress import StageProgress
    from sdm.cli.fits.fit_report import NOT_CONVERGED, print_points
    from sdm.deepsdf import DeepSDF
    from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
    from sdm.deepsdf.infer.fit_code import surface_of_code
    from sdm.deepsdf.infer.fit_deepsdf import fit_deepsdf_points
    from sdm.errors import SDMError
    from sdm.io.files.json_file import write_json
    from sdm.io.meshes.write import save_mesh

    model = DeepSDF.load(name, device)
    with StageProgress() as progress:
        fit = fit_deepsdf_points(found, model, turn=turn, report=progress)
    backend = DeepSDFBackend(model)
    record = {**fit.components.record(backend.parameters), "points": len(found), "code": fit.code.record()}
    write_json(out, record)
    if not (fit.components.converged and fit.code.converged):
        raise SDMError(f"{NOT_CONVERGED}: {points} may be no shape of this DeepSDF, or turned further (--turn)")
    if mesh is not None:
        save_mesh(surface_of_code(backend, fit.code.code, fit.code.state), mesh)
    print_points(record, fit.components.posterior.state, len(found), fit.components.mean_distance, "")
    code = fit.code
    print(
        f"code   all {len(code.code):,} numbers, of which the points determine {code.determined:.0f}, size "
        f"{float(code.state.theta[0]):.4g}: {code.mean_distance:.4g} from the points; the surface is of these, without "
        "intervals"
    )
