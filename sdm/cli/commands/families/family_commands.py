"""`sdm family NAME`: what a family of shapes is like."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sdm.cli.common.subcommands import union_of

FAMILY_COMMANDS = {
    "check": "sdm.cli.commands.families.check_family:check",
    "show": "sdm.cli.commands.families.show_family:show",
}

if TYPE_CHECKING:
    Look = Callable[[], int | None]
else:
    Look = union_of(FAMILY_COMMANDS)


def family(what: Look) -> int | None:
    """Check a family of shapes, or draw it: cochlea, ..., FILE.py:NAME of your own, or a shape model, MODEL.npz.

    Args:
        what: check or show; `sdm family check --help` lists its options.
    """
    return what()
