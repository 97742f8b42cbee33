"""`sdm completion`: commands and options completed by the shell."""

from __future__ import annotations

from typing import Literal

import tyro


def completion(shell: tyro.conf.Positional[Literal["bash", "zsh", "tcsh"]]) -> int:
    """Print what a shell needs to complete commands and options by the tab key.

    Args:
        shell: The shell that will read it.
    """
    from sdm.cli.app import main

    # `--tyro-print-completion` is the parser's own option.
    return main(["--tyro-print-completion", shell])
