"""`sdm view`: a map to look at from all sides."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device


def view(
    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP_OR_MESH")],
    *,
    level: Annotated[float, tyro.conf.arg(metavar="DISTANCE")] = 0.0,
    resolution: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 96)")] = None,
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE.png", help_behavior_hint="(default: a window)")
    ] = None,
    device: Device = "auto",
) -> None:
    """Look at a signed distance map: its surface, and a cut through it that the mouse moves.

    Of a mesh the map is computed first. Needs the extra "viewer".

    Args:
        file: A map (.nii.gz, .nii, .npz, .nrrd, .mha, .mhd, .vti, .zarr, .nvdb), or a mesh (STL, PLY, OBJ, OFF,
            GLB, ...).
        level: Distance of the surface shown, in the map's unit; 0 is the mesh's own.
        resolution: Voxels along each axis of a mesh's map.
        out: Draw a picture in place of opening a window; needs no display.
        device: Where a mesh's map is computed: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.label_maps import looks_like_labels
    from sdm.core.device import choose_device
    from sdm.core.grid import Grid
    from sdm.engine.api import signed_distance_map
    from sdm.errors import GridError, SDMError
    from sdm.io import load, load_mesh
    from sdm.io.maps.formats import is_map_name
    from sdm.shapes.family import check_resolution
    from sdm.viz.viewer import check_view
    from sdm.viz.viewer import view as show

    if is_map_name(file):
        if resolution is not None:
            raise GridError(f"{file} is a map, which has its own voxels: leave out --resolution")
        field = load(file)
        if level == 0 and looks_like_labels(field.values):
            raise SDMError(f"{file} looks like a label volume: sdm edt makes the distance maps of its classes")
        show(field, level=level, picture=out)
        return
    voxels = 96 if resolution is None else resolution
    check_resolution(voxels)
    check_view(out)
    mesh = load_mesh(file)
    field = signed_distance_map(mesh, Grid.around(mesh, resolution=voxels), device=choose_device(device))
    show(field, mesh=mesh, level=level, picture=out)
