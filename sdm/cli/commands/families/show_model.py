"""`sdm shape-model show`: modes and measures of a shape model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from sdm.cli.common.printed_line import print_line

if TYPE_CHECKING:
    from sdm.core.signed_distance_map import SDM


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
    from sdm.shapes.models.model_file import kind_of, load_model
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
        meshes = [_surface(field) for field in shapes]
        facts = maps.facts
    else:
        family = load_model(model)
        count = len(family.parameters)
        theta = [[0.0] * count]
        for k in range(min(modes, count)):
            theta += [[end if j == k else 0.0 for j in range(count)] for end in (-family.limit, family.limit)]
        meshes = [family.mesh(one).numpy() for one in theta]
        facts = family.facts
    model_sheet(meshes, facts, out, title=model.name)
    for name in ("generalisation", "specificity"):
        if name in facts and facts[name]["modes"]:
            curve = facts[name]
            print(f"{name}: " + ", ".join(f"{y:.3g} ({m})" for m, y in zip(curve["modes"], curve["mean"], strict=True)))
    shares = facts.get("compactness", [])
    print("compactness: " + ", ".join(f"{100 * x:.3g} % ({n + 1})" for n, x in enumerate(shares[:10])))
    print_line(f"{out}: the mean and {(len(meshes) - 1) // 2} modes of {model}")
    return None


def _surface(field: SDM) -> tuple[Any, Any] | None:
    """Vertices and faces of a mode's map; None of one that is nowhere inside, as ends of modes of maps may be."""
    from sdm.errors import SDMError

    try:
        return field.to_mesh().numpy()
    except SDMError:
        return None
