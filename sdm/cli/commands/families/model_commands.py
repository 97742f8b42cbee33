"""`sdm shape-model NAME`: statistical shape models from meshes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sdm.cli.common.subcommands import union_of

MODEL_COMMANDS = {
    "build": "sdm.cli.commands.families.build_shape_model:build",
    "show": "sdm.cli.commands.families.show_model:show",
    "import": "sdm.cli.commands.families.import_model:import_model",
}

if TYPE_CHECKING:
    Part = Callable[[], int | None]
else:
    Part = union_of(MODEL_COMMANDS)


def shape_model(what: Part) -> int | None:
    """Build a statistical shape model from meshes, draw it, or take over another tool's.

    A model of points is a family, as cochlea is.

    Args:
        what: build, show or import; `sdm shape-model build --help` lists its options.
    """
    return what()
