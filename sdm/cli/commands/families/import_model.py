"""`sdm shape-model import`: a shape model that another tool made."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.printed_line import print_line


def import_model(
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")],
    /,
    *,
    mean: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    vertices: Annotated[str | None, tyro.conf.arg(metavar="FIRST:END", help_behavior_hint="(default: all)")] = None,
) -> None:
    """Take over a model of principal components from GIAS, as articulated-ssm has them of bones (.pc.npz).

    Args:
        source: The model, .pc.npz: mean, weights and modes. Nothing in it is unpickled.
        mean: Mesh of the mean shape with the model's vertices: its faces are taken.
        out: Model to write, .npz.
        vertices: The vertices to take, those of one bone of several.
    """
    from sdm.io import load_mesh
    from sdm.shapes.models.gias_model import read_gias_model
    from sdm.shapes.models.model_file import save_model

    model = read_gias_model(source, load_mesh(mean), vertices=_range(vertices))
    save_model(model, out)
    shares = (model.deviations**2 / (model.deviations**2).sum())[:3].tolist()
    print_line(
        f"{out}: {len(model.mean):,} vertices, {len(model.triangles):,} faces, {len(model.modes)} modes with "
        f"{', '.join(f'{100 * share:.3g} %' for share in shares)} of the variance"
    )


def _range(words: str | None) -> slice | None:
    from sdm.errors import FormatError

    if words is None:
        return None
    first, colon, end = words.partition(":")
    if not (colon and first.isdigit() and end.isdigit()):
        raise FormatError(f"--vertices is {words!r}; give FIRST:END, two numbers of vertices, such as 9366:14482")
    return slice(int(first), int(end))
