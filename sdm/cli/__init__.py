"""The command line `sdm`.

A command is one file here with one function of the same name: typed arguments become options, the docstring becomes
the help, with units. It prints its results, returns None or an exit code, and raises the classes of `sdm.errors` for
what is the user's to mend. Its name then goes into `COMMANDS`. Heavy imports (torch, warp, trimesh) wait until the
function runs, so that help comes at once.
"""

from sdm.cli.app import COMMANDS, main

__all__ = ["COMMANDS", "main"]
