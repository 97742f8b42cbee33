"""`sdm encode`: the codes of meshes or scans under a trained DeepSDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line


def encode(
    shapes: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="SHAPE [SHAPE ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"])],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    scan: bool = False,
    sphere: Annotated[
        tuple[float, float, float, float] | None,
        tyro.conf.arg(metavar="X Y Z RADIUS", help_behavior_hint="(default: the shape's own)"),
    ] = None,
    steps: int = 800,
    seed: int = 0,
    device: Device = "auto",
) -> None:
    """Find the code of a shape that a DeepSDF was not trained on: the most probable one, given samples of the shape.

    Writes .npz files for sdm decode. Several meshes are encoded at once, which is faster than one by one.

    Args:
        shapes: Closed meshes, turned if they are inside out; with --scan, points: .npy of (N,3), or (N,6) with outward
            normals, a point cloud (.ply, .xyz), or a mesh file, whose vertices are the points.
        model: What sdm train deepsdf wrote, or cochlea: the one that comes with the package.
        out: File to write, ending in .npz; or for several shapes a folder.
        scan: The shapes are points of surfaces, perhaps of a part: find whole shapes that go through them.
        sphere: Centre and radius of the sphere around the whole shape. A scan of a part needs it.
        steps: Optimisation steps.
        seed: Whole number that everything random depends on.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.cli.common.output_files import targets_in
    from sdm.cli.fits.points_file import points_of
    from sdm.deepsdf import DeepSDF, encode_meshes, encode_scan, save_code
    from sdm.deepsdf.samples import UnitSphere
    from sdm.errors import FormatError, SDMError
    from sdm.io import load_mesh
    from sdm.io.maps.formats import check_file

    if not shapes:
        raise SDMError("say which shapes to encode: one or more files")
    for shape in shapes:
        if shape.is_dir():
            raise FormatError(f"{shape} is a folder; name its files, as {shape}/*.ply does")
    if len(shapes) == 1 and out.suffix != ".npz":
        raise FormatError(f"{out} does not end like a code: use .npz")
    if len(shapes) > 1 and out.suffix:
        raise FormatError(f"{out} is one file, but {len(shapes)} shapes were given; give a folder")
    # A file that is named twice is encoded once.
    sources = list(dict.fromkeys(shapes))
    targets = [out] if len(shapes) == 1 else targets_in(out, sources, "npz")
    refuse_inputs(targets, [*sources, model])
    given = None if sphere is None else UnitSphere(sphere[:3], sphere[3])
    found = DeepSDF.load(model, device)
    scans = [points_of(path) for path in sources] if scan else []
    meshes = [] if scan else [load_mesh(path) for path in sources]
    if len(shapes) > 1:
        out.mkdir(parents=True, exist_ok=True)
    # Before the search, which takes minutes.
    for target in targets:
        check_file(target)
    if scan:
        codes = [encode_scan(found, *points, sphere=given, steps=steps, seed=seed) for points in scans]
    else:
        spheres = None if given is None else [given] * len(meshes)
        codes = encode_meshes(found, meshes, steps=steps, seed=seed, spheres=spheres)
    for target, code in zip(targets, codes, strict=True):
        save_code(code, target)
        print_line(f"{target}: {found.code_size} numbers, sphere of radius {code.sphere.radius:.4g}")
