"""`sdm shape-model build`: a mean and modes of variation from meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line


def build(
    meshes: Annotated[
        tyro.conf.Positional[list[Path]], tyro.conf.arg(metavar="MESH|FOLDER ...", help_behavior_hint="(required)")
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    method: Literal["points", "sdm"] = "points",
    scale: bool = False,
    modes: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 98 % of the variance)")
    ] = None,
    template: Annotated[Path | None, tyro.conf.arg(metavar="MESH", help_behavior_hint="(default: made)")] = None,
    triangles: int = 6000,
    lay: bool = False,
    limit: float = 3.0,
    resolution: int = 64,
    device: Device = "auto",
) -> int | None:
    """Build a statistical shape model: a mean, modes of variation and their standard deviations.

    Meshes with the same faces are in correspondence as they are; onto others, which have to be closed and lie roughly
    alike, a template is laid by exact distances both ways. Shapes are then aligned (generalised Procrustes) and their
    principal components taken.

    Args:
        meshes: Mesh files, or folders of them: three shapes or more.
        out: Model to write, .npz. A model of points is a family for every command: sdm family show MODEL.npz.
        method: points, or sdm: principal components of the signed distance maps themselves, which need no
            correspondence and are no family.
        scale: Take sizes out.
        modes: How many modes to keep.
        template: Lay this mesh onto each, and not an even one of middle volume.
        triangles: About how many triangles the template has that is made.
        lay: Lay a template even onto meshes with the same faces.
        limit: How many standard deviations the model's box of parameters reaches to each side.
        resolution: Voxels along the longest edge of the maps of --method sdm.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.cli.common.output_files import inputs_of
    from sdm.cli.common.progress import CountProgress
    from sdm.errors import FormatError, MeshError, SDMError
    from sdm.io import load_mesh
    from sdm.io.files.atomic import try_to_write
    from sdm.shapes.models.build_model import build_model
    from sdm.shapes.models.sdm_modes import build_sdm_modes

    if out.suffix.lower() != ".npz":
        raise FormatError(f"{out} does not end with .npz, as shape models do")
    if method == "sdm" and (template is not None or lay):
        raise SDMError("--template and --lay are for models of points; --method sdm needs no correspondence")
    if not meshes:
        raise MeshError("no mesh was given: name three mesh files or more, or a folder of them")
    files = list(inputs_of(meshes))
    if not files:
        raise MeshError(f"no mesh file was found in {', '.join(map(str, meshes))}")
    refuse_inputs([out], [*files, template])
    try_to_write(out)
    found = [load_mesh(path) for path in files]
    with CountProgress("shapes") as progress:
        if method == "sdm":
            maps = build_sdm_modes(
                found, scale=scale, modes=modes, resolution=resolution, device=device, progress=progress
            )
            maps.save(out)
            print_line(
                f"{out}: {len(maps.modes)} modes of the maps of {len(found)} shapes, {_share(maps.facts, maps.modes)}"
            )
            return None
        model = build_model(
            found,
            scale=scale,
            modes=modes,
            template=None if template is None else load_mesh(template),
            triangles=triangles,
            correspond=False if lay else None,
            limit=limit,
            device=device,
            progress=progress,
        )
    model.save(out)
    rows = [row for row in model.facts["shapes"] if "distance" in row]
    if rows:
        worst = max(rows, key=lambda row: row["distance"])
        print_line(
            f"template laid: {sum(row['distance'] for row in rows) / len(rows):.4g} from the meshes on average, "
            f"{worst['distance']:.4g} from {worst['name']}; {sum(row['turned'] for row in rows)} faces turned over, "
            f"{sum(row['cut'] for row in rows)} in another part of their shape"
        )
    print_line(f"{out}: {len(model.modes)} modes of {len(found)} shapes, {_share(model.facts, model.modes)}")
    return None


def _share(facts: dict, modes: object) -> str:
    return f"{100 * facts['compactness'][len(modes) - 1]:.4g} % of the variance"  # type: ignore[arg-type]
