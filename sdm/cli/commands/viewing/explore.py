"""`sdm explore`: a page in the browser with shapes that follow sliders, and maps that a plane cuts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device


def explore(
    thing: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FAMILY_OR_FILE")] = "cochlea",
    *,
    stream: bool = False,
    fit: Annotated[Path | None, tyro.conf.arg(metavar="IMAGE", help_behavior_hint="(default: none)")] = None,
    surrogate: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: the cochlea's that is shipped)")
    ] = None,
    seed: int = 0,
    resolution: int = 64,
    unit: Annotated[str, tyro.conf.arg(metavar="UNIT", help_behavior_hint="(default: the family's)")] = "",
    port: int = 8080,
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1",
    device: Device = "auto",
) -> None:
    """Explore a family, mesh, map, narrow band, dataset, stream, fit or DeepSDF model in the browser.

    Of a family, sliders set the parameters and the surface follows: by the surrogate, whose error may be coloured on
    the exact surface, where there is one, and by the exact engine else. With --stream, the samples of its training
    stream are shown as they come, and with --fit the steps of its fit to an image. Of a mesh, signs by winding numbers
    and by a flood may be compared, also where it is open. Of a map, a slider moves the surface. Of a DeepSDF model, a
    slider goes from one shape's code to another's. A plane with lines of equal distance, dragged by its arrow, cuts all
    of them. Needs the extra "explore", and no display: it prints the address, and the ssh command for another machine.
    Ctrl-C or the end of the terminal ends it.

    Args:
        thing: A family (cochlea, ellipsoid, ..., FILE.py:NAME, which is run, or a shape model's MODEL.npz), a mesh
            (STL, PLY, OBJ, ...), a map or narrow band (.nii.gz, .npz, .nrrd, .nvdb, ...), a dataset of
            `sdm generate`, or a DeepSDF model (MODEL.pt of `sdm train deepsdf`, or deepsdf: the one that is shipped).
        stream: Show the samples that SDMStream makes of the family, as they come.
        fit: Fit the family to this image (NIfTI, NRRD, ..., cropped to the shape), and show each step.
        surrogate: Of the family: a folder of `sdm train sdmnn --family`, or a cochlea's file of weights.
        seed: Whole number that the samples of --stream depend on.
        resolution: Voxels along each axis of maps that are computed.
        unit: Of lengths, for the colour bar, for example mm.
        port: Port to listen on.
        host: Address to listen on. The default is reached from this machine alone; 0.0.0.0 from every machine, without
            a password.
        device: Where maps are computed: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.core.device import choose_device
    from sdm.errors import SDMError
    from sdm.explore.scene_of import moving_scene_of, scene_of
    from sdm.explore.session import check_place
    from sdm.explore.session import explore as serve

    if resolution < 2:
        raise SDMError(f"--resolution is {resolution}; give at least 2")
    if stream and fit is not None:
        raise SDMError("--stream and --fit are two scenes: give one of them")
    moving = stream or fit is not None
    if moving and surrogate is not None:
        raise SDMError("--surrogate is for sliders: leave it out with --stream and --fit, which are exact")
    check_place(host, port)
    where = choose_device(device)
    if moving:
        scene, known_unit = moving_scene_of(thing, fit, resolution=resolution, device=where, seed=seed)
    else:
        scene, known_unit = scene_of(thing, resolution=resolution, device=where, surrogate=surrogate)
    serve(scene, host=host, port=port, unit=unit or known_unit, say=lambda line: print(line, flush=True))
