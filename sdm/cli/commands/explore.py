"""`sdm explore`: a page in the browser with shapes that follow sliders, and maps that a plane cuts."""

from __future__ import annotations

from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device


def explore(
    thing: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FAMILY_OR_FILE")] = "cochlea",
    *,
    resolution: int = 64,
    unit: Annotated[str, tyro.conf.arg(metavar="UNIT", help_behavior_hint="(default: the family's)")] = "",
    port: int = 8080,
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1",
    device: Device = "auto",
) -> None:
    """Explore a family, mesh, map, narrow band or dataset in the browser.

    Of a family, sliders set the parameters and the surface follows: by the surrogate, whose error may be coloured on
    the exact surface, where one comes with the package (the cochlea), and by the exact engine else. Of a mesh, signs by
    winding numbers and by a flood may be compared, also where it is open. Of a map, a slider moves the surface. A plane
    with lines of equal distance cuts all of them. Needs the extra "explore", and no display: it prints the address, and
    the ssh command for another machine. Ctrl-C ends it.

    Args:
        thing: A family (cochlea, ellipsoid, ..., FILE.py:NAME, which is run, or a shape model's MODEL.npz), a mesh
            (STL, PLY, OBJ, ...), a map or narrow band (.nii.gz, .npz, .nrrd, .nvdb, ...), or a dataset of
            `sdm generate`.
        resolution: Voxels along each axis of maps that are computed.
        unit: Of lengths, for the colour bar, for example mm.
        port: Port to listen on.
        host: Address to listen on. The default is reached from this machine alone; 0.0.0.0 from every machine, without
            a password.
        device: Where maps are computed: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.core.device import choose_device
    from sdm.errors import SDMError
    from sdm.explore.scene_of import scene_of
    from sdm.explore.session import check_place
    from sdm.explore.session import explore as serve

    if resolution < 2:
        raise SDMError(f"--resolution is {resolution}; give at least 2")
    check_place(host, port)
    scene, known_unit = scene_of(thing, resolution=resolution, device=choose_device(device))
    serve(scene, host=host, port=port, unit=unit or known_unit, say=lambda line: print(line, flush=True))
