"""`sdm surface`: triangle meshes of maps, and of the classes of label volumes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device


def surface(
    maps: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="MAP [MAP ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    level: Annotated[float, tyro.conf.arg(metavar="LENGTH")] = 0.0,
    label: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: each but 0, of label volumes)")
    ] = None,
    smooth: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: voxels as they are)")
    ] = None,
    format: Annotated[  # noqa: A002
        Literal["ply", "stl", "obj", "off", "glb", "vtk", "vtp", "gii"] | None,
        tyro.conf.arg(help_behavior_hint="(default: as OUT ends, or ply)"),
    ] = None,
    mesh_space: Literal["ras", "lps"] = "ras",
    device: Device = "auto",
) -> int | None:
    """Make the triangle mesh of a map's surface, by marching cubes: in the map's coordinates, facing outward.

    One map gives one file; several, or a folder of them, give a folder, in which they lie as in the folder that was
    named. Of a label volume (whole numbers, none below 0) each class is a mesh: OUT organs.stl gives organs_1.stl,
    organs_2.stl, ..., and organs.stl if there is one class alone; in a folder all have their class in the name. With
    another --level than 0 such a volume is an image, unless --label or --smooth is given. A bad map is reported at the
    end, the others are done, and the exit code is 2.

    Args:
        maps: Maps, narrow bands or label volumes (.nii.gz, .nii, .npz, .nrrd, .mha, .mhd, .vti, .zarr, .nvdb), or
            folders of them, nested as deep as they are.
        out: File to write (its ending is the format: .ply, .stl, .obj, .off, .glb, .vtk, .vtp, .gii, .pial, .white), or
            a folder.
        level: Distance of the mesh from the map's surface, in the map's unit; below 0 it is inside.
        label: The class of a label volume to make a mesh of.
        smooth: Take the steps of a label volume's voxels away: the standard deviation of the Gaussian that does so, in
            the image's unit. The volume stays.
        format: File format, for meshes written to a folder.
        mesh_space: lps writes the mesh in left-posterior-superior coordinates, with x and y negated; maps are in ras,
            right-anterior-superior.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.label_maps import LabelMaps
    from sdm.cli.surfaces.map_surfaces import MapSurfaces, targets_of
    from sdm.core.device import choose_device

    labels = LabelMaps(classes=None if label is None else [label], smooth=smooth, device=choose_device(device))
    work = MapSurfaces(level=level, labels=labels, flipped=mesh_space == "lps")
    return work.run(targets_of(maps, out, format), out)
