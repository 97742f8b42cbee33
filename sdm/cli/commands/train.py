"""`sdm train NAME`: the networks that this package trains, by name."""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Union

import tyro

# Name -> "module:function". The function's typed arguments become options, its docstring the help, as for a command.
# Its module is imported for the help, so it imports torch and the like inside the function.
TRAININGS = {
    "deepsdf": "sdm.cli.commands.trainings.train_deepsdf:deepsdf",
    "sdmnn": "sdm.cli.commands.trainings.train_sdmnn:sdmnn",
    "segmentation": "sdm.cli.commands.trainings.train_segmentation:segmentation",
}


def _later(name: str) -> Callable[..., Callable[[], int | None]]:
    """A function that prepares the training `name` from its options and does not run it yet."""
    module, function = TRAININGS[name].split(":")
    training = getattr(import_module(module), function)

    @functools.wraps(training)
    def prepare(*args: Any, **kwargs: Any) -> Callable[[], int | None]:
        return functools.partial(training, *args, **kwargs)

    return prepare


if TYPE_CHECKING:
    Training = Callable[[], int | None]
else:
    # A union has at least two members, so that a hidden one goes with a training that is alone.
    Training = Union[
        (
            *(Annotated[Any, tyro.conf.subcommand(name=name, constructor=_later(name))] for name in TRAININGS),
            Annotated[None, tyro.conf.Suppress],
        )
    ]


def train(what: Training) -> int | None:
    """Train a network on exact maps that are made as they are needed.

    Args:
        what: The network to train; `sdm train NAME --help` lists its options.
    """
    return what()
