"""`sdm watertight`: closed surfaces of meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device


def watertight(
    meshes: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="MESH [MESH ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    resolution: int = 512,
    offset: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: 0 if closed, else half a voxel)")
    ] = None,
    hole_size: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: two voxels)")
    ] = None,
    hidden: Literal["drop", "keep"] = "drop",
    method: Literal["cubes", "dual"] = "cubes",
    format: Annotated[  # noqa: A002
        Literal["ply", "stl", "obj", "off", "glb", "vtk", "vtp"] | None,
        tyro.conf.arg(help_behavior_hint="(default: as OUT ends, or ply)"),
    ] = None,
    report: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: of a folder OUT/report.json)")
    ] = None,
    skip_bad: bool = False,
    resume: bool = False,
    device: Device = "auto",
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: no cluster)")] = None,
) -> int | None:
    """Make one closed surface of each mesh: of sheets, holes, soup, parts that cross, faces that face all ways.

    Prints how far the mesh and its surface are apart, both ways: exact distances of all vertices and 100,000 points of
    each. One mesh gives one file; several, or a folder of them, give a folder. A bad mesh stops no other; the exit code
    is then 2.

    Args:
        meshes: Mesh files (STL, PLY, OBJ, OFF, GLB, ...), or folders of them, nested as deep as they are.
        out: File to write (its ending is the format: .ply, .stl, .obj, .off, .glb, .vtk, .vtp), or a folder.
        resolution: Voxels along the longest edge of a mesh's box.
        offset: Distance of the surface from the mesh, in its unit, at most ten times the length of the mesh. From 0.87
            voxels on nothing of a mesh is lost.
        hole_size: With --hidden drop, gaps narrower than this length are closed.
        hidden: drop fills what no way leads into from outside; keep keeps cavities.
        method: cubes (marching cubes), or dual (dual contouring), which keeps edges and corners sharp.
        format: File format, for surfaces written to a folder.
        report: JSON file to write about all meshes.
        skip_bad: Meshes that cannot be used are listed in a table at the end, and are no failure.
        resume: Skip meshes whose surface is in the folder already: made from the same mesh, with the same options.
        device: auto, cpu, cuda or cuda:N; auto is every GPU of this machine, or the CPU if there is none. Of few meshes
            one GPU makes all.
        ray: Share the meshes among the GPUs of this Ray cluster; "auto" is the one this machine belongs to.
    """
    from sdm.runtime import early_device

    if len(meshes) == 1 and meshes[0].is_file() and ray is None:
        early_device.begin(device)

    # A flood's kernels too, which the first surface needs and a library's user may not.
    import sdm.kernels.flood.flood_signs  # noqa: F401
    from sdm.cli.surfaces.closing import run, targets_of
    from sdm.cli.surfaces.closing_stages import Closing
    from sdm.errors import SDMError
    from sdm.runtime.sharing.devices import devices_for

    options = Closing(
        resolution=resolution, offset=offset, hole_size=hole_size, hidden=hidden, method=method, device=device
    )
    jobs, folder = targets_of(meshes, out, format)
    if resume and not folder:
        raise SDMError(f"--resume is for surfaces in a folder: {out} is one file, and is made again without it")
    if report is None and folder:
        report = out / "report.json"
    where = {"folder": out if folder else None, "devices": devices_for(device), "ray": ray}
    return run(jobs, options, report=report, skip_bad=skip_bad, resume=resume, **where)
