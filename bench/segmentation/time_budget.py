"""Steps of each of many trainings, so that all of them fit into a time."""

from __future__ import annotations

from collections.abc import Callable

from sdm.bench.segmentation.log_file import LogFile

# Steps before the clock counts: kernels are chosen and compiled, memory is taken.
WARM = 15
MEASURED = 30
# Jobs do not end at the same moment on all devices, and several processes share the host.
RESERVE = 0.85
# Least share of a GPU's time that one process leaves unused: an assumption on the safe side, not a measurement.
GAPS = 0.15


def fitted_steps(
    measure: Callable[[int], float], jobs: int, devices: int, budget_s: float, *, weight: float, overhead_s: float
) -> int:
    """Steps for every job, a multiple of 50.

    Args:
        measure: Seconds of so many steps of a usual job, on one device.
        jobs: How many there are.
        devices: Processes that share them.
        budget_s: Time for all.
        weight: Time of the mean job over that of a usual one.
        overhead_s: Seconds of a job beside its steps.
    """
    measure(WARM)
    each = measure(MEASURED) / MEASURED
    rounds = -(-jobs // devices)
    seconds = RESERVE * budget_s / rounds - overhead_s
    steps = max(50, int(seconds / (weight * each)) // 50 * 50)
    print(f"{1 / each:.1f} steps a second: {steps} steps for each of {jobs} jobs on {devices} devices", flush=True)
    return steps


def shared(processes: int) -> float:
    """Time of a step with so many processes on a GPU, over that of one alone: each fills some of the others' gaps."""
    return 1.0 if processes == 1 else processes * (1.0 - GAPS)


def known_steps(logs: LogFile) -> int | None:
    """The steps of the trainings that are there already: all rows of a table have the same."""
    found = logs.trainings()
    return found[0]["job"]["settings"]["steps"] if found else None
