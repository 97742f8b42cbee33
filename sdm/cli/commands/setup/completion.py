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
    from sdm.errors import SDMError

    try:
        # `--tyro-print-completion` is the parser's own option.
        return main(["--tyro-print-completion", shell])
    except ImportError as error:
        # The parser itself has those of bash and zsh.
        raise SDMError(
            f"completion in {shell} needs {error.name or 'shtab'}, which is not installed: pip install shtab"
        ) from error
