"""Functions that hang, take their process down or write nothing, in a module that a new process imports in no time."""

from __future__ import annotations

import os
import time

from sdm.errors import FormatError


def misbehave(how: str) -> dict[str, str]:
    """`how` is "hang", "die" or anything else, which is given back."""
    if how == "hang":
        time.sleep(600)
    if how == "die":
        os._exit(3)
    return {"how": how}


def refuse(*_: object) -> None:
    raise FormatError("the disk is full")
