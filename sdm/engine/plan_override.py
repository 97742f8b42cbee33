"""Options that calls are planned with, for tests and measurements: a context overrides them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any

from sdm.kernels.plan_options import PlanOptions

USUAL = PlanOptions()
# Read as a call is planned. Recordings of calls are told apart by it.
OPTIONS: ContextVar[PlanOptions] = ContextVar("OPTIONS", default=USUAL)


@contextmanager
def plan_override(**changes: Any) -> Iterator[None]:
    """Plan this thread's calls meanwhile with other options, see `PlanOptions`; those not named stay."""
    token = OPTIONS.set(replace(OPTIONS.get(), **changes))
    try:
        yield
    finally:
        OPTIONS.reset(token)
