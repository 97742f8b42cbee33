"""`sdm compute`: signed distance maps of one mesh or many."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device, Ending, options_given
from sdm.cli.common.numbers import numbers
from sdm.cli.common.printed_line import print_line

REPORT = "report.json"
# Options that each say what the grid is.
GRIDS = ("--resolution", "--spacing", "--grid-like")


def compute(
    meshes: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="MESH [MESH ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    resolution: Annotated[
        tuple[int, ...] | None, numbers(int, "N [N N]"), tyro.conf.arg(help_behavior_hint="(default: 128)")
    ] = None,
    spacing: Annotated[
        tuple[float, ...] | None,
        numbers(float, "S [S S]"),
        tyro.conf.arg(help_behavior_hint="(in place of --resolution)"),
    ] = None,
    grid_like: Annotated[
        Path | None, tyro.conf.arg(metavar="IMAGE", help_behavior_hint="(in place of --resolution)")
    ] = None,
    margin: Annotated[float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: 0.05)")] = None,
    device: Device = "auto",
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: no cluster)")] = None,
    format: Annotated[  # noqa: A002
        Ending | None, tyro.conf.arg(help_behavior_hint="(default: as OUT ends, or nii.gz)")
    ] = None,
    orient: Literal["keep", "auto", "parts"] = "keep",
    sign: Literal["winding", "flood", "none"] = "winding",
    hole_size: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: two voxels)")
    ] = None,
    scale: float = 1.0,
    mesh_space: Literal["ras", "lps"] = "ras",
    normalize: Annotated[
        Literal["sphere", "cube"] | None,
        tyro.conf.arg(metavar="{sphere,cube}", help_behavior_hint="(default: as they are)"),
    ] = None,
    dtype: Literal["float32", "float16"] = "float32",
    truncate: Annotated[float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: none)")] = None,
    band: Annotated[float | None, tyro.conf.arg(metavar="VOXELS", help_behavior_hint="(default: all voxels)")] = None,
    resume: bool = False,
    skip_bad: bool = False,
    report: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: OUT/report.json with --skip-bad, else none)"),
    ] = None,
) -> int | None:
    """Compute the exact signed distance maps of meshes: negative inside, in the mesh's own unit of length.

    An image in place of a mesh is a label volume, and its maps are those of `sdm edt`, which has options for them.

    One mesh gives one file; several meshes, or a folder of them, give a folder of maps, in which they lie as in the
    folder that was named. Of several meshes a bad one is reported at the end, the others are computed, and the exit
    code is 2. Reading, computing and writing of several meshes run beside each other.

    Args:
        meshes: Mesh files (STL, PLY, OBJ, OFF, GLB, ...), or folders of them, nested as deep as they are.
        out: File to write (by its ending .nii.gz, .nii, .npz, .nrrd, .mha, .mhd, .vti, .zarr, .nvdb), or a folder.
        resolution: Voxels along each axis: one number for a cube around the mesh, or three.
        spacing: Voxel size in the mesh's unit: one length, or one for each axis.
        grid_like: The grid of this NIfTI or NRRD image, or of another map.
        margin: Room around the mesh, as a share of the longest edge of its box.
        device: auto, cpu, cuda or cuda:N; auto is every GPU of this machine, or the CPU if there is none. Of few meshes
            one GPU makes all.
        ray: Share the meshes among the GPUs of this Ray cluster; "auto" is the one this machine belongs to.
        format: File format, for maps written to a folder. A zarr map may be larger than memory.
        orient: auto makes faces agree and turns parts that are inside out; parts turns every patch of faces outward by
            what sees it from outside; keep takes meshes as they are.
        sign: winding goes by the generalised winding number; flood calls inside what a ball from outside cannot reach,
            whichever way faces face; none writes unsigned distances. sdm inspect recommends one.
        hole_size: With --sign flood, the ball's diameter, in the mesh's unit after --scale: narrower gaps are closed.
        scale: Multiply the vertices by this first: 1000 for a mesh in metres and an image in millimetres.
        mesh_space: lps for a mesh in left-posterior-superior coordinates, whose x and y are negated first; images and
            maps are in ras, right-anterior-superior.
        normalize: Shift and scale each mesh, which its map then tells: sphere puts the furthest vertex 1/1.03 from the
            origin, as DeepSDF does; cube puts the box's longest edge from -1 to 1. Distances and lengths are then in
            that unit.
        dtype: Type of the values in .npz and .zarr files.
        truncate: Distances beyond this length become this, with their sign; a .nvdb file then keeps the blocks within.
        band: Write a narrow band alone (sdm.SparseSDM): the voxels so near to the surface, 3 for example, in blocks of
            8^3. Time and memory grow with the surface. To .npz, .zarr or .nvdb.
        resume: Skip meshes whose map is there already: on the same grid, and made from the same mesh (checksum stored
            in the map, or as OUT/unfinished.jsonl says of files that nobody touched since). Other files under its name
            are replaced.
        skip_bad: Meshes that cannot be used are listed in a table at the end, and are no failure.
        report: JSON file to write about every mesh: triangles, closed or not, sign, warnings, seconds, or why not.
    """
    given = options_given(compute, locals())
    from sdm.cli.common.imports_that_stay import imports_that_stay
    from sdm.cli.maps.map_sharing import early_processes
    from sdm.runtime import early_device

    # A cluster has its own.
    with early_processes(meshes if ray is None else [], device, resolution, out if resume else None) as others:
        with imports_that_stay():
            # Warp starts beside torch's libraries, and what comes after torch is imported beside the GPU.
            import sdm.kernels  # noqa: F401

            if ray is None:
                early_device.begin(device)
            from sdm.cli.common.output_files import plan
            from sdm.cli.maps.map_settings import Settings, one_or_three
            from sdm.cli.maps.run import run
            from sdm.core.device import choose_device
            from sdm.engine.arguments import SignMethod
            from sdm.io import grid_like as read_grid
            from sdm.io.maps.formats import is_map_name
            from sdm.runtime.sharing.devices import devices_for

        SignMethod(sign, hole_size)
        _refuse_two_grids(given)
        size, step = one_or_three("--resolution", resolution), one_or_three("--spacing", spacing)
        if len(meshes) == 1 and is_map_name(meshes[0]):
            return _label_maps(meshes[0], out, given, sign, device)
        settings = Settings(
            resolution=size,
            spacing=step,
            like=None if grid_like is None else read_grid(grid_like),
            like_image=grid_like,
            margin=0.05 if margin is None else margin,
            device=choose_device(device),
            orient=orient,
            sign=sign,
            hole_size=hole_size,
            scale=scale,
            mesh_space=mesh_space,
            normalize=normalize,
            dtype=dtype,
            truncate=truncate,
            band=band,
            resume=resume,
        )
        if grid_like is not None:
            _tell_if_not_placed(grid_like)
        jobs = plan(meshes, out, format, *([] if band is None else ["npz"]))
        # All files of a folder have one format.
        settings.check_format(jobs[0][1])
        folder = out if out.is_dir() and not is_map_name(out) else None
        if report is None and skip_bad and folder is not None:
            report = folder / REPORT
        # A map that is there already is skipped by --resume, and so may give the grid of the others.
        _refuse_clashes(jobs, report, None if resume else grid_like)
        where = {"devices": devices_for(device), "ray": ray, "folder": folder}
        return run(jobs, settings, report=report, skip_bad=skip_bad, others=others, **where)


def _refuse_two_grids(given: list[str]) -> None:
    from sdm.errors import GridError

    grids = [name for name in GRIDS if name in given]
    if len(grids) > 1:
        raise GridError(f"{' and '.join(grids)} each say what the grid is: give one of them")
    if "--margin" in given and "--grid-like" in given:
        raise GridError("--margin is room around the mesh, and --grid-like says where the grid is: give one of them")


def _label_maps(source: Path, out: Path, given: list[str], sign: str, device: str) -> None:
    """The maps of a label volume's classes.

    Raises:
        GridError: A grid is given, which is the volume's own.
        SDMError: An option is given that says something of meshes alone.
    """
    from sdm.cli.common.label_maps import LabelMaps, refuse_mesh_options, write_label_maps
    from sdm.core.device import choose_device
    from sdm.errors import GridError, SDMError

    for name in (name for name in GRIDS if name in given):
        raise GridError(f"{source} is a label volume, whose maps are on its own grid: leave out {name}")
    ours = ("--device", "--sign") if sign == "none" else ("--device",)
    refuse_mesh_options(source, [f"--sign {sign}" if name == "--sign" else name for name in given if name not in ours])
    if source.is_dir() and source.suffix.lower() != ".zarr":
        raise SDMError(f"{source} is a folder; give one label volume")
    write_label_maps(source, out, LabelMaps(signed=sign != "none", device=choose_device(device)))


def _tell_if_not_placed(image: Path) -> None:
    from sdm.io.maps.save_and_load import is_placed

    if not is_placed(image):
        print_line(
            f"sdm: {image} does not say how it lies in space (qform and sform have code 0): "
            "it is placed as nibabel does, and other software may lay the map elsewhere than the image",
            error=True,
        )


def _refuse_clashes(jobs: list[tuple[Path, Path]], report: Path | None, like: Path | None) -> None:
    from sdm.cli.common.inputs import refuse_inputs, refuse_twice
    from sdm.io.maps.formats import check_file

    refuse_inputs([*(target for _, target in jobs), report], [*(source for source, _ in jobs), like])
    if report is not None:
        refuse_twice(report, (target for _, target in jobs))
        check_file(report)
