"""Types of arguments by the words that stand for them in help: N for whole numbers, X for others, DEVICE."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import tyro

Device = Annotated[str, tyro.conf.arg(metavar="DEVICE")]
# Of files of maps.
Ending = Literal["nii.gz", "nii", "npz", "nrrd", "mha", "mhd", "vti", "zarr", "nvdb"]


def options_given(command: Callable[..., Any], values: Mapping[str, Any]) -> list[str]:
    """Options of a command, such as `--hole-size`, whose values are not their defaults."""
    return [
        f"--{name.replace('_', '-')}"
        for name, argument in inspect.signature(command).parameters.items()
        if argument.default not in (argument.empty, values[name])
    ]


WORDS: dict[Any, str] = {int: "N", float: "X", str: "TEXT"}
NUMBERS = tyro.constructors.ConstructorRegistry()


@NUMBERS.primitive_rule
def _number(info: tyro.constructors.PrimitiveTypeInfo) -> tyro.constructors.PrimitiveConstructorSpec[Any] | None:
    """Words of help in place of Python's names of types."""
    if info.type not in WORDS:
        return None
    kind = info.type
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar=WORDS[kind],
        instance_from_str=lambda words: kind(words[0]),
        is_instance=lambda value: isinstance(value, kind) and not isinstance(value, bool),
        str_from_instance=lambda value: [str(value)],
    )
