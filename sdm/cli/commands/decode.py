"""`sdm decode`: from a code to a mesh, a map or a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import counted, print_line


def decode(
    code: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CODE")],
    /,
    *,
    model: Annotated[Path, tyro.conf.arg(aliases=["-m"])],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    to: Annotated[Path | None, tyro.conf.arg(metavar="CODE", help_behavior_hint="(default: none)")] = None,
    count: int = 7,
    resolution: int = 256,
    device: Device = "auto",
) -> None:
    """Turn a code of sdm encode into a mesh, a map or a picture, by how the output's name ends.

    .ply, .stl, .obj, .off, .glb, .vtk and .vtp are the surface, by marching cubes. .nii.gz, .nii, .npz, .nrrd, .mha,
    .mhd, .vti, .zarr and .nvdb are the learned signed distance map of the box around the shape's sphere, negative
    inside, in the shape's unit. .png is a picture by sphere tracing.

    Args:
        code: What sdm encode wrote.
        model: The model that the code belongs to, or cochlea: the one that comes with the package.
        out: File to write.
        to: Another code: a strip of pictures from the first to this one.
        count: Pictures of the strip.
        resolution: Voxels along each axis, or pixels of a picture.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.core.grid import Grid
    from sdm.deepsdf import DeepSDF, decode_mesh, interpolation_strip, load_code, render, save_picture
    from sdm.errors import FormatError
    from sdm.io.maps.formats import FORMATS, check_file, check_target, is_map_name
    from sdm.io.meshes.write import WRITERS, save_mesh

    if to is not None and out.suffix.lower() != ".png":
        raise FormatError(f"{out} does not end like a picture, but a strip of pictures was requested: use .png")
    refuse_inputs([out], [code, model, to])
    ending = out.suffix.lower().removeprefix(".")
    if ending == "png" or ending in WRITERS:
        check_file(out)
    elif is_map_name(out):
        check_target(out)
    else:
        raise FormatError(
            f"cannot write {out.suffix or out.name}: use one of .{', .'.join([*WRITERS, 'png', *FORMATS])}"
        )
    shape, found = load_code(code), DeepSDF.load(model, device)
    if to is not None:
        picture = interpolation_strip(found, shape.code, load_code(to).code, count=count, size=resolution)
        save_picture(picture, out)
    elif ending == "png":
        save_picture(render(found, shape.code, size=resolution), out)
    elif ending in WRITERS:
        mesh = decode_mesh(found, shape.code, sphere=shape.sphere, resolution=resolution)
        save_mesh(mesh, out)
        print_line(f"{out}: {counted(len(mesh), 'triangle')}")
        return
    else:
        sphere = shape.sphere
        step = 2 * sphere.radius / max(resolution - 1, 1)
        grid = Grid([c - sphere.radius for c in sphere.centre], (step,) * 3, (resolution,) * 3)
        found.signed_distance_map(grid, shape.code, sphere).save(out)
    print_line(out)
