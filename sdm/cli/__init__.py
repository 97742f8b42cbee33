"""The command line `sdm`.

A command is one file here with one function of the same name: typed arguments become options, the docstring becomes
the help, with units. It prints its results, returns None or an exit code, and raises the classes of `sdm.errors` for
what is the user's to mend. Its name then goes into `COMMANDS`. Heavy imports (torch, warp, trimesh) wait until the
function runs, so that help comes at once.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.cli.app import COMMANDS

__all__ = ["COMMANDS", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; see `sdm.cli.app.main`. An interrupt while the program is still being read is one line, too."""
    try:
        # The parser takes 50 ms to import, most of the time in which a quick Ctrl+C comes.
        from sdm.cli.app import main as run

        return run(arguments)
    except KeyboardInterrupt:
        print("sdm: interrupted", file=sys.stderr)
        return 130
    finally:
        if arguments is None:
            # The process ends now. Python would look through all of its objects for garbage before, several times.
            gc.freeze()


def __getattr__(name: str) -> Any:
    if name == "COMMANDS":
        from sdm.cli.app import COMMANDS

        return COMMANDS
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
