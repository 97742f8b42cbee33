"""Draw the documentation's explanations: `python -m sdm.bench.drawings`, seconds on a CPU."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from sdm.bench.common.checkout import docs_folder
from sdm.bench.drawings.culling_tests import draw_culling
from sdm.bench.drawings.largest_errors import draw_errors
from sdm.bench.drawings.sample_numbers import draw_samples
from sdm.bench.drawings.signs_of_damage import draw_signs

DRAWINGS: dict[str, Callable[[Path], None]] = {
    "signs.png": draw_signs,
    "exact.png": draw_errors,
    "culling.png": draw_culling,
    "samples.png": draw_samples,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Draw all, or those that are named."""
    parser = argparse.ArgumentParser("python -m sdm.bench.drawings", description=(__doc__ or "").split(":")[0])
    parser.add_argument("--out", type=Path, default=docs_folder(), help="folder to write to (default: docs/)")
    parser.add_argument("--only", nargs="*", choices=DRAWINGS, default=list(DRAWINGS), help="some of them")
    options = parser.parse_args(argv)
    for name in options.only:
        DRAWINGS[name](options.out / name)
        print(options.out / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
