"""`sdm family show`: a sheet of a family's shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.printed_line import print_line

# Triangles that a small picture of a shape needs.
ENOUGH = 4000


def show(
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="FAMILY")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    count: int = 12,
    triangles: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: few, where the family has a choice)")
    ] = None,
    seed: int = 0,
) -> int | None:
    """Draw a sheet of a family: the centre of its box, both ends of each parameter, corners, and random shapes.

    Args:
        name: cochlea, ..., FILE.py:NAME (the file is run), or a shape model, MODEL.npz.
        out: Picture to write: .png, .pdf, .svg, .jpg or .webp.
        count: Random shapes.
        triangles: About how many triangles a shape is drawn with, of a family that can be made of fewer or more.
        seed: Whole number that the random ones depend on.
    """
    import torch

    from sdm.errors import MeshError
    from sdm.shapes import load_family
    from sdm.viz.family_sheet import check_picture, family_sheet

    if not 0 <= count <= 60:
        raise MeshError(f"--count is {count}; give 0 to 60")
    check_picture(out)
    family = load_family(name, triangles=triangles)
    if triangles is None:
        family = family.with_triangles(ENOUGH) or family
    width = len(family.parameters)
    unit, captions = [torch.full((width,), 0.5, device="cpu")], ["centre"]
    for number, parameter in enumerate(family.parameters[:6]):
        for end, value in ((0.0, parameter.low), (1.0, parameter.high)):
            place = torch.full((width,), 0.5, device="cpu")
            place[number] = end
            unit.append(place)
            captions.append(f"{parameter.name} = {value:g}")
    for end in (0.0, 1.0):
        unit.append(torch.full((width,), end, device="cpu"))
        captions.append("all lowest" if end == 0 else "all highest")
    theta = torch.cat([family.from_unit(torch.stack(unit)), family.sample(count, seed=seed, device="cpu")])
    captions += [f"random {number}" for number in range(count)]
    shapes = []
    for one in theta:
        group = next(iter(family.groups(one[None], one[None])))
        shapes.append((group.vertices[0].detach().cpu().numpy(), group.faces.cpu().numpy()))
    family_sheet(shapes, captions, out, title=f"{family.name}: {width} parameters, {len(shapes[0][1]):,} triangles")
    print_line(f"{out}: {len(shapes)} shapes of {name}")
    return None
