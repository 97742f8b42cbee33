"""Settings of all tests of fits."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import sdm.fit.study.simulate


@pytest.fixture(scope="package", autouse=True)
def coarse_simulation() -> Iterator[None]:
    """Simulated images of an eighth of the sample points: still finer than any fit's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sdm.fit.study.simulate, "FINE", 0.1)
        patch.setattr(sdm.fit.study.simulate, "SHARP", 4)
        yield
