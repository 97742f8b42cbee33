"""`sdm train sdmnn`: surrogates of the cochlea family."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def sdmnn(
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
) -> int | None:
    """Train a surrogate of the cochlea family: from four shape parameters to a signed distance map.

    Args:
        out: Folder for checkpoints and the weights.
    """
    print(out)
    return None
