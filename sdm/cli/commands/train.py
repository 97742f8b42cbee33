"""`sdm train NAME`: the networks that this package trains, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sdm.cli.common.subcommands import union_of

# Name -> "module:function". The function's typed arguments become options, its docstring the help, as for a command.
TRAININGS = {
    "deepsdf": "sdm.cli.commands.trainings.train_deepsdf:deepsdf",
    "sdmnn": "sdm.cli.commands.trainings.train_sdmnn:sdmnn",
    "segmentation": "sdm.cli.commands.trainings.train_segmentation:segmentation",
}

if TYPE_CHECKING:
    Training = Callable[[], int | None]
else:
    Training = union_of(TRAININGS)


def train(what: Training) -> int | None:
    """Train a network on exact maps that are made as they are needed.

    Args:
        what: The network to train; `sdm train NAME --help` lists its options.
    """
    return what()
