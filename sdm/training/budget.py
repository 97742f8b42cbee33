"""Budgets of trainings: steps and seconds, whichever ends first."""

from __future__ import annotations

from sdm.errors import SDMError


def share_done(step: int, steps: int, seconds: float, budget_s: float | None) -> float:
    """0 to 1: how far a training is, by its steps or by its seconds, whichever is nearer its end.

    Raises:
        SDMError: As `check_budget`.
    """
    check_budget(budget_s)
    by_clock = 0.0 if budget_s is None else seconds / budget_s
    return min(1.0, max(step / steps, by_clock))


def check_budget(budget_s: float | None) -> None:
    """Refuse a budget in which nothing can be trained.

    Raises:
        SDMError: It is neither positive nor None.
    """
    if budget_s is not None and not budget_s > 0:
        raise SDMError(f"a budget of {budget_s:g} seconds trains nothing: give a positive number, or none")
