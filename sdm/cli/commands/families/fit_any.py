"""`sdm fit` of any family: to an image by exact distances, or to points."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def fit_any_family(
    image: Path,
    name: str,
    out: Path,
    mesh: Path | None,
    picture: Path | None,
    given: dict[str, Any],
    triangles: int | None,
    device: str,
    *,
    with_blur: bool = False,
    with_formation: bool = False,
    residuals: Path | None = None,
    mirror: bool = False,
) -> None:
    """Fit a family to an image, and write report, surface and picture.

    Args:
        image: The image's file.
        name: The family, as every command takes it.
        out: Report, JSON.
        mesh: Surface, or None.
        picture: Picture, or None.
        given: Options of `FitOptions`; those that are None count as not given.
        triangles: Of the family's meshes, where that can be chosen.
        device: Where.
        with_blur: Estimate the blur with the shape.
        with_formation: Estimate the image's formation with the shape.
        residuals: Residual map, or None.
        mirror: Fit mirror images of the family's shapes.
    """
    import sdm
    from sdm.cli.common.fit_report import print_fit, save_residuals
    from sdm.cli.common.progress import StageProgress
    from sdm.fit import ExactBackend, FitOptions
    from sdm.fit.model.scaled_family import MirroredFamily, factor_of
    from sdm.fit.solve.fit_family import BLUR, fit_family
    from sdm.shapes import load_family

    family = load_family(name, triangles=triangles)
    family = MirroredFamily(family) if mirror else family
    scan = sdm.load(image)
    factor = factor_of(family)
    usual = {
        "blur": BLUR * max(scan.grid.spacing),
        "fine": FitOptions.fine / factor,
        "shift": FitOptions.shift / factor,
    }
    options = FitOptions(**{**usual, **{key: value for key, value in given.items() if value is not None}})
    with StageProgress() as progress:
        result = fit_family(
            scan.values,
            scan.grid,
            family,
            options=options,
            with_blur=with_blur,
            with_formation=with_formation,
            device=device,
            report=lambda stage, step, _: progress.draw(f"{stage}, step {step}", 0, None),
        )
    result.save(out)
    save_residuals(scan, result, residuals)
    result.require()
    if mesh is not None or picture is not None:
        from sdm.viz.fit_figure import draw_fit, write_surface

        backend = ExactBackend(family, device)
        if mesh is not None:
            write_surface(backend, result, mesh)
        if picture is not None:
            draw_fit(scan.values, scan.grid, backend, result, picture)
    print_fit(result, options.blur, _unit(family))


def fit_family_points(
    points: Path, name: str, out: Path, mesh: Path | None, turn: float, triangles: int | None, device: str
) -> None:
    """Fit a family to points of a file, and write report and surface."""
    import json

    from sdm.core.mesh import TriangleMesh
    from sdm.errors import SDMError
    from sdm.fit import ExactBackend
    from sdm.fit.model.jacobian import vertices_of
    from sdm.fit.solve.fit_points import fit_points
    from sdm.io.files.atomic import replacing
    from sdm.io.meshes.write import save_mesh
    from sdm.shapes import load_family

    family = load_family(name, triangles=triangles)
    found = points_of(points)
    backend = ExactBackend(family, device)
    fit = fit_points(found, backend, turn=turn)
    record = {**fit.record(family.parameters), "points": len(found)}
    with replacing(out) as part:
        part.write_text(json.dumps(record, indent=1) + "\n")
    if not fit.converged:
        raise SDMError(f"the fit did not converge: {points} may be no shape of this family, or turned further (--turn)")
    state = fit.posterior.state
    if mesh is not None:
        vertices = state.to_world(vertices_of(family, state.theta)).float().cpu()
        save_mesh(TriangleMesh(vertices, family.faces, "fit", check=False), mesh)
    unit = _unit(family)
    for key, value in record["theta"].items():
        low, high = value["interval"]
        print(f"{key:<6} {value['estimate']:.4f}, 90 % within {low:.4f} to {high:.4f}")
    print(f"centre {', '.join(f'{x:.3f}' for x in state.translation.tolist())} {unit}".rstrip())
    print(
        f"{len(found):,} points, {fit.mean_distance:.4g} {unit}".rstrip()
        + " from the shape on average; intervals take "
        "them to be independent"
    )


def points_of(path: Path) -> Any:
    """Points (N,3) of a mesh's vertices, a point cloud or a .npy file.

    Raises:
        SDMError: It cannot be read, or holds no points.
    """
    import numpy as np

    from sdm.errors import FormatError, MeshError
    from sdm.io import load_mesh

    if not path.is_file():
        raise FormatError(f"{path} cannot be read: no such file")
    if path.suffix.lower() == ".npy":
        try:
            points = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FormatError(f"{path} is no .npy file of numbers") from error
        if points.ndim != 2 or points.shape[1] not in (3, 6) or points.dtype.kind not in "fiu":
            raise FormatError(f"{path} holds an array of shape {points.shape}; (N, 3) numbers are needed")
        return points[:, :3]
    try:
        return load_mesh(path).vertices
    except MeshError as error:
        # A scan has points and no triangles.
        if "no triangles" not in str(error):
            raise
    import trimesh

    try:
        cloud = trimesh.load(path, process=False)
        return np.asarray(cloud.vertices, dtype=np.float64)  # pyright: ignore[reportAttributeAccessIssue]
    except Exception as error:
        raise FormatError(f"{path} cannot be read as points: {type(error).__name__}") from error


def _unit(family: Any) -> str:
    lengths = {p.unit for p in family.parameters} & {"mm", "cm", "m"}
    return lengths.pop() if len(lengths) == 1 else ""
