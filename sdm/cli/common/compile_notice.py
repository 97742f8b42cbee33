"""Notice that kernels compile, which takes long and happens once for each group of kernels on a machine."""

from __future__ import annotations

import functools
import sys
from types import ModuleType
from typing import Any

NOTICE = "sdm: compiling kernels that this command is the first to need: about ten seconds, more on a busy machine"
# Warp's own builders: what they made is kept in a cache, and they are called for what is not in it.
BUILDERS = ("build_cpu", "build_cuda")


def announce_compiling(builders: ModuleType | None = None) -> None:
    """From now on say on stderr that kernels compile, when the first one does in this process.

    Args:
        builders: The module with Warp's builders. They are private to Warp: where they are not found, nothing is said.
    """
    if builders is None:
        import warp

        builders = getattr(getattr(warp, "_src", None), "build", None)
    said: list[bool] = []
    for name in BUILDERS:
        builder = getattr(builders, name, None)
        if builder is not None and not hasattr(builder, "__wrapped__"):
            setattr(builders, name, _announced(builder, said))


def _announced(builder: Any, said: list[bool]) -> Any:
    @functools.wraps(builder)
    def build(*args: Any, **kwargs: Any) -> Any:
        if not said:
            said.append(True)
            # The library's own notice, for those who do not come by a command, would say it again.
            from sdm.kernels.launches.compiling import keep_silent

            keep_silent()
            print(NOTICE, file=sys.stderr, flush=True)
        return builder(*args, **kwargs)

    return build
