"""`sdm fit`: a shape and its pose from an image, or from points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device

if TYPE_CHECKING:
    from sdm.fit import FitOptions


def fit(
    image: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="IMAGE", help_behavior_hint="(or --points)")
    ] = None,
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    family: Annotated[str | None, tyro.conf.arg(metavar="FAMILY", help_behavior_hint="(default: the cochlea)")] = None,
    points: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: an image)")] = None,
    mesh: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    picture: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    blur: Annotated[
        float | None,
        tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: 0.2; with --family half a voxel)"),
    ] = None,
    estimate_blur: bool = False,
    estimate_formation: bool = False,
    residuals: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    free_form: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    model: Annotated[
        Literal["partial-volume", "labels"] | None,
        tyro.conf.arg(metavar="{partial-volume,labels}", help_behavior_hint="(default: partial-volume)"),
    ] = None,
    components: Annotated[
        tuple[int, int] | None, tyro.conf.arg(metavar="N N", help_behavior_hint="(default: 1 1)")
    ] = None,
    fine: Annotated[
        float | None,
        tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: 0.15; of other sizes in proportion)"),
    ] = None,
    turn: float = 0.5,
    mirror: bool = False,
    backend: Literal["exact", "surrogate", "hybrid"] = "exact",
    triangles: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 20000; with --family its own)")
    ] = None,
    weights: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: the package's)")
    ] = None,
    device: Device = "auto",
) -> None:
    """Fit a family of shapes to an image: shape parameters and pose with 90 % intervals. By default the cochlea to CT.

    The image is cropped to one shape and a little around, in the family's unit (a cochlea: millimetres), and turned
    roughly as the family is (the axis of the spiral along z). If the steps do not converge, or there is no such shape
    in the image, the command says so, writes the report with "trusted": false, and exits with code 2.

    Args:
        image: A NIfTI or NRRD image, in Hounsfield units or any other.
        family: cochlea, ..., FILE.py:NAME of yours (the file is run), a shape model, MODEL.npz, or a DeepSDF, MODEL.pt,
            whose size and code are fitted.
        points: Fit points of the surface instead: a point cloud (.ply, .xyz), a mesh file's vertices, or .npy
            (N,3), in the family's unit.
        out: The report to write, JSON: estimates, intervals, covariance, pose, diagnosis.
        mesh: Also write the fitted surface here, as .ply, .stl, .obj, .glb or what else sdm.save_mesh writes, in the
            image's coordinates.
        picture: Also draw the image with the fitted outline here (.png, .pdf, .svg).
        blur: Standard deviation of the scanner's point spread function, mm.
        estimate_blur: Estimate the blur with the shape, from --blur on; intervals then hold what is not known of it.
        estimate_formation: Estimate blur, intensities that change smoothly over the image, and the noise's correlation
            with the shape, and check by the residuals whether the model describes the image.
        residuals: Also write the image less what the fit expects, as an image (.nii.gz, .nrrd, ...).
        free_form: Also move the vertices of the fitted surface to where the image is explained best, free of the family
            and with no intervals, and write that surface here, as --mesh; even where the family does not explain enough
            for the fit to be trusted.
        model: partial-volume: voxels mix inside and outside; labels: each is one or the other.
        components: Gaussians for the intensities inside and outside, for example 1 2.
        fine: Largest distance between the sample points of a voxel, mm.
        turn: How far the shape may be turned from the family's own frame, standard deviation about each axis, rad.
            From 1 on the search begins at rotations all around.
        mirror: Fit mirror images of the shapes: ears of the other side.
        backend: exact distances; the surrogate's, anchored near the end by two exact evaluations; or hybrid, the
            surrogate first and exact to finish.
        triangles: Triangles of the exact backend's meshes.
        weights: A surrogate's weights; those that come with the package if not given.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    import sdm
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.cli.fits.fit_progress import FitProgress
    from sdm.cli.fits.fit_report import FitFiles, write_fit
    from sdm.core.device import choose_device
    from sdm.errors import SDMError
    from sdm.fit import FitOptions, fit_shape
    from sdm.fit.model.backend import exact_of
    from sdm.fit.model.backends import make_backends
    from sdm.fit.model.exact import TRIANGLES

    refuse_inputs([out, mesh, picture, residuals, free_form], [image, weights])
    _check_targets(out, [mesh, free_form], picture, residuals)
    of_image = {"model": model, "components": components, "blur": blur, "fine": fine}
    given = {**of_image, "turn": turn}
    if points is not None:
        estimates = {"estimate_blur": estimate_blur, "estimate_formation": estimate_formation, "mirror": mirror}
        targets = {"picture": picture, "residuals": residuals, "free_form": free_form}
        _refuse_with_points({**targets, **estimates, **of_image})
    options = FitOptions(**{name: value for name, value in given.items() if value is not None})
    if model == "labels" and not (blur is None and fine is None):
        raise SDMError(
            "--blur and --fine are of --model partial-volume: with labels a voxel is one point, and has no blur"
        )
    _check_estimates(estimate_blur, estimate_formation, options)
    choose_device(device)
    files = FitFiles(out, mesh, picture, residuals, free_form)
    if points is not None or family is not None:
        if backend != "exact" or weights is not None:
            raise SDMError(
                "--backend and --weights are for images of the cochlea: other shapes, and points, have one backend"
            )
        if (points is None) == (image is None):
            raise SDMError("give an image or --points, and not both")
    if points is not None:
        from sdm.cli.commands.families.fit_any import fit_family_points

        refuse_inputs([out, mesh], [points])
        return fit_family_points(points, family or "cochlea", out, mesh, turn, triangles, device)
    if image is None:
        raise SDMError("give an image, or --points FILE; see sdm fit --help")
    if family is not None:
        from sdm.cli.commands.families.fit_any import fit_any_family

        return fit_any_family(
            image, family, files, given, triangles, device,
            with_blur=estimate_blur, with_formation=estimate_formation, mirror=mirror,
        )  # fmt: skip
    if weights is not None and backend == "exact":
        raise SDMError("--weights are a surrogate's: leave them out, or ask for --backend surrogate or hybrid")
    scan = sdm.load(image)
    first, finish = make_backends(
        backend, triangles=TRIANGLES if triangles is None else triangles, weights=weights, device=device, mirror=mirror
    )
    with FitProgress(image, scan, options) as progress:
        result = fit_shape(scan.values, scan.grid, first, finish=finish, options=options, report=progress)
        exact = finish or exact_of(first) or first
        if estimate_formation:
            from sdm.fit.solve.formation import estimate as formations

            result = formations.estimate_formation(scan.values, scan.grid, exact, result, options, report=progress)
        elif estimate_blur and result.trusted:
            from sdm.fit.solve import estimate_blur as blurs

            result = blurs.estimate_blur(scan.values, scan.grid, exact, result, options, report=progress)
    write_fit(files, scan, finish or first, result, blur=options.blur)
    return None


def _check_estimates(blur: bool, formation: bool, options: FitOptions) -> None:
    """Refuse before the fit what it could not go on with after it."""
    from sdm.errors import SDMError

    if formation and (options.model == "labels" or tuple(options.components) != (1, 1)):
        raise SDMError("--estimate-formation is for --model partial-volume and --components 1 1")
    if blur and options.model == "labels":
        raise SDMError("--estimate-blur is for --model partial-volume: labels have no blur")
    if (blur or formation) and not options.blur > 0:
        raise SDMError("--estimate-blur and --estimate-formation go on from --blur: give one above 0")


def _refuse_with_points(options: dict[str, object]) -> None:
    """Refuse options that a fit to points has no use for."""
    from sdm.errors import SDMError

    given = [f"--{name.replace('_', '-')}" for name, value in options.items() if not (value is None or value is False)]
    if given:
        *others, last = given
        names = f"{', '.join(others)} and {last}" if others else last
        verb, them = ("are", "them") if others else ("is", "it")
        raise SDMError(f"{names} {verb} of an image's fit: leave {them} out with --points")


def _check_targets(out: Path, meshes: list[Path | None], picture: Path | None, residuals: Path | None) -> None:
    """Find out before the fit, which takes minutes, what could not be written after it."""
    from sdm.cli.common.inputs import refuse_twice
    from sdm.errors import FormatError
    from sdm.io.maps.formats import check_file, format_of
    from sdm.io.meshes.write import ending_to_write
    from sdm.viz.fit_figure import FORMATS

    for mesh in meshes:
        if mesh is not None:
            ending_to_write(mesh)
    if residuals is not None:
        format_of(residuals)
    if picture is not None and picture.suffix.lower().lstrip(".") not in FORMATS:
        raise FormatError(f"{picture} does not end like a picture: use one of .{', .'.join(FORMATS)}")
    targets = [target for target in (out, *meshes, picture, residuals) if target is not None]
    for number, target in enumerate(targets):
        check_file(target)
        refuse_twice(target, targets[:number])
