"""The best rate of a grid, once all of it is there."""

from __future__ import annotations

import time

from sdm.bench.studies.rate_search import best_rate


def test_the_least_error_of_the_grid_is_chosen() -> None:
    # 9.0 is none of the grid.
    assert best_rate(lambda: {0.1: 3.0, 0.2: 1.0, 0.3: 1.0, 9.0: 0.0}, (0.1, 0.2, 0.3), time.monotonic()) == 0.2


def test_it_waits_for_all_of_the_grid_and_no_longer_than_the_deadline() -> None:
    looks = [{0.1: 1.0}, {0.1: 1.0}, {0.1: 1.0, 0.2: 0.5}]
    assert best_rate(lambda: looks.pop(0), (0.1, 0.2), time.monotonic() + 60, every_s=0.0) == 0.2
    assert looks == []
    assert best_rate(lambda: {0.1: 1.0}, (0.1, 0.2), time.monotonic() - 1) is None
