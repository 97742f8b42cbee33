"""`sdm sample`: training samples of a folder of meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device


def sample(
    meshes: Annotated[
        tyro.conf.Positional[list[Path]],
        tyro.conf.arg(metavar="MESH [MESH ...]", help_behavior_hint="(required)"),
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    layout: Literal["deepsdf", "occupancy", "zarr", "webdataset"] = "deepsdf",
    law: Annotated[
        Literal["paper", "released"] | None,
        tyro.conf.arg(metavar="{paper,released}", help_behavior_hint="(default: paper)"),
    ] = None,
    count: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the layout's)")] = None,
    near: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the law's)")] = None,
    uniform: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the law's)")] = None,
    surface: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the law's)")] = None,
    deviations: Annotated[
        tuple[float, ...] | None,
        tyro.conf.arg(metavar="LENGTH [LENGTH ...]", help_behavior_hint="(default: the law's)"),
    ] = None,
    box: Annotated[float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: the law's)")] = None,
    normalize: Annotated[
        Literal["sphere", "cube", "none"] | None,
        tyro.conf.arg(metavar="{sphere,cube,none}", help_behavior_hint="(default: the layout's)"),
    ] = None,
    dataset: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the folder's)")] = None,
    split: Annotated[str | None, tyro.conf.arg(metavar="PART", help_behavior_hint="(default: all)")] = None,
    closest: bool = False,
    sign: Literal["winding", "flood", "none"] = "winding",
    hole_size: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: two voxels)")
    ] = None,
    open_meshes: Annotated[
        Literal["reject", "keep"] | None, tyro.conf.arg(metavar="{reject,keep}", help_behavior_hint="(default: reject)")
    ] = None,
    orient: Literal["auto", "parts", "keep"] = "auto",
    seed: int = 0,
    device: Device = "auto",
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: no cluster)")] = None,
    resume: bool = False,
    skip_bad: bool = False,
) -> int | None:
    """Write training samples of meshes: points near the surface, in a box and on it, with exact signed distances.

    The same seed gives the same samples, whatever else is in the folder. Writes
    OUT/report.json about every mesh. A bad mesh stops no other; the exit code is then 2.

    Args:
        meshes: Mesh files, or folders of them, nested as deep as they are: the folders name classes and instances.
        out: Folder to write.
        layout: deepsdf: SdfSamples and NormalizationParameters, as facebookresearch/DeepSDF reads them; occupancy:
            points.npz and pointcloud.npz, as Occupancy Networks reads them; zarr: one array of all; webdataset: tar
            files.
        law: paper: DeepSDF's, 475,000 of 500,000 samples near the surface by the variances 0.0025 and 0.00025;
            released: that of its code, 470,000 by 0.005 and 0.0005. The layout occupancy has its own: half in a box of
            1.1 times the shape's cube, half on the surface.
        count: Samples of each mesh: 500,000, of occupancy 200,000.
        near: Of every near + uniform + surface samples, so many are near the surface,
        uniform: so many anywhere in the box,
        surface: and so many on the surface.
        deviations: Standard deviations of those near the surface, taken in turn, in the normalised unit.
        box: Half the edge of the box, in the normalised unit.
        normalize: sphere: the furthest vertex is 1/1.03 from the origin; cube: the longest edge of the box is from -1
            to 1; none: the mesh stays where it is.
        dataset: Name of the dataset in DeepSDF's paths.
        split: The part of the folder to sample, of those that sdm split made of it. The lists of the parts are written
            beside the samples of all, too: splits/train.json, CLASS/train.lst, and in sampling.json.
        closest: Write closest points and normals too; for --layout webdataset.
        sign: winding goes by the generalised winding number; flood calls inside what a ball from outside cannot reach,
            for meshes with holes or whose faces look all ways; none writes unsigned distances.
        hole_size: With --sign flood, the ball's diameter, in the normalised unit: narrower gaps are closed.
        open_meshes: With --sign winding, what to do with meshes that have holes.
        orient: auto turns components that are inside out; parts turns every patch of faces outward by what sees it from
            outside; keep takes meshes as they are. Normals face as faces then do.
        seed: Whole number that the samples depend on, besides the mesh's path below the folder.
        device: auto, cpu, cuda or cuda:N; auto is every GPU of this machine, or the CPU if there is none. Of few meshes
            one GPU makes all.
        ray: Share the meshes among the GPUs of this Ray cluster; "auto" is the one this machine belongs to.
        resume: Go on with a folder that was cut off; the samples that are there stay.
        skip_bad: Meshes that cannot be used are listed in a table at the end, and are no failure.
    """
    from sdm.cli.maps.sample_run import SampleOptions, run
    from sdm.runtime.sharing.devices import devices_for

    options = SampleOptions(
        law=law,
        shares=(near, uniform, surface),
        deviations=deviations,
        box=box,
        normalize=normalize,
        count=count,
        closest=closest,
        sign=sign,
        hole_size=hole_size,
        open_meshes=open_meshes,
        seed=seed,
        orient=orient,
    )
    more = {"dataset": dataset, "split": split, "device": device, "devices": devices_for(device), "ray": ray}
    return run(meshes, out, layout, options, **more, resume=resume, skip_bad=skip_bad)
