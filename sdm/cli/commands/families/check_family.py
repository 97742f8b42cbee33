"""`sdm family check`: a family by samples."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line


def check(
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="FAMILY")],
    /,
    *,
    count: int = 64,
    triangles: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the family's own)")
    ] = None,
    seed: int = 0,
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: none)")
    ] = None,
    device: Device = "auto",
) -> int | None:
    """Check that a family's shapes are closed, face outward and do not cut themselves, and that derivatives are right.

    Looks at random samples, the centre of the box of parameters and, up to 64 of them, its corners. Ends with exit code
    2 where a shape or a derivative is wrong.

    Args:
        name: cochlea, cuboid, rhomboid, ellipsoid, cylinder, geometric-shapes, FILE.py:NAME (the file is run), or a
            shape model, MODEL.npz.
        count: Number of random shapes.
        triangles: About how many triangles a shape has.
        seed: Whole number that the samples depend on.
        out: Write all figures to this JSON file too.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.errors import FormatError, MeshError
    from sdm.io.files.json_file import write_json
    from sdm.shapes import family_record, load_family
    from sdm.shapes.family_check import check_family

    if count < 1:
        raise MeshError(f"--count is {count}; give 1 or more")
    if out is not None and out.suffix != ".json":
        raise FormatError(f"{out} does not end with .json")
    refuse_inputs([out], [Path(name.rpartition(":")[0] or name)])
    family = load_family(name, triangles=triangles)
    found = check_family(family, samples=count, seed=seed, device=device)
    print_line(f"{name}: {len(family.parameters)} parameters, {found.triangles:,} triangles a shape")
    for p in family.parameters:
        print(f"  {p.name:<12} {p.low:g} to {p.high:g}" + ("" if p.unit == "1" else f" {p.unit}"))
    print(f"closed       {_share(found.closed)} of {found.samples} shapes")
    print(f"outward      {_share(found.outward)}")
    print(f"self-cutting {_share(found.self_crossing)}, at most {_share(found.worst_crossing)} of one's faces")
    apart = "by rounding alone" if found.derivative_error == 0 else f"by at most {100 * found.derivative_error:.2g} %"
    print(f"derivatives  differ from finite differences {apart}")
    volumes = "" if found.least_volume is None else f", volumes {found.least_volume:.4g} to {found.most_volume:.4g}"
    print(f"sizes        {found.smallest:.4g} to {found.largest:.4g}{volumes}")
    print(f"speed        {found.maps_per_second:.3g} maps of 64^3 a second on {found.device}")
    if out is not None:
        write_json(out, {"family": family_record(family), **found.record()})
    if found.problems:
        raise MeshError(f"{name} is not sound: {'; '.join(found.problems)}")
    return None


def _share(value: float) -> str:
    # What is not all must not read as all.
    return "none" if value == 0 else f"{min(99.9, 100 * value):.3g} %" if value < 1 else "100 %"
