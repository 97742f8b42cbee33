"""`sdm shape-model show`: modes and measures of a shape model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def show(
    model: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MODEL")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    modes: int = 3,
) -> int | None:
    """Draw a shape model: its mean and its first modes at plus and minus 3 deviations, and its three curves.

    The curves are compactness (share of the variance), generalisation (a shape left out, by the model of the others)
    and specificity (random shapes from the nearest real one), as mean distances of vertices, as it was built.

    Args:
        model: A model that sdm shape-model build wrote.
        out: Picture to write: .png, .pdf, .svg, .jpg or .webp. Curves are printed.
        modes: How many modes to draw.
    """
    from sdm.errors import FormatError
    from sdm.shapes.models.model_file import kind_of
    from sdm.shapes.models.sdm_modes import KIND, SDMModes
    from sdm.viz.family_sheet import check_picture
    from sdm.viz.model_sheet import model_sheet

    if modes < 1:
        raise FormatError(f"--modes is {modes}; give 1 or more")
    check_picture(out)
    if kind_of(model) == KIND:
        maps = SDMModes.load(model)
        shapes = [maps.map([0.0])]
        shapes += [maps.map([0.0] * k + [end]) for k in range(min(modes, len(maps.modes))) for end in (-3.0, 3.0)]
        meshes = [field.to_mesh().numpy() for field in shapes]
        facts = maps.facts
    else:
        from sdm.shapes import load_family

        family = load_family(model)
        count = len(family.parameters)
        theta = [[0.0] * count]
        for k in range(min(modes, count)):
            theta += [[end if j == k else 0.0 for j in range(count)] for end in (-family.limit, family.limit)]  # type: ignore[attr-defined]
        meshes = [family.mesh(one).numpy() for one in theta]
        facts = family.facts  # type: ignore[attr-defined]
    model_sheet([(v, f) for v, f in meshes], facts, out, title=model.name)
    for name in ("generalisation", "specificity"):
        if name in facts and facts[name]["modes"]:
            curve = facts[name]
            print(f"{name}: " + ", ".join(f"{y:.3g} ({m})" for m, y in zip(curve["modes"], curve["mean"], strict=True)))
    shares = facts.get("compactness", [])
    print("compactness: " + ", ".join(f"{100 * x:.3g} % ({n + 1})" for n, x in enumerate(shares[:10])))
    print(f"{out}: the mean and {(len(meshes) - 1) // 2} modes of {model}")
    return None
