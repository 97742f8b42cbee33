"""`sdm doctor`: what this machine has, what is missing, and kernels compiled ahead."""

from __future__ import annotations

import json as as_json
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from sdm.cli.common.argument_types import Device

if TYPE_CHECKING:
    from rich.console import Console


def doctor(
    *,
    compile_kernels: Annotated[bool, tyro.conf.arg(name="compile")] = False,
    device: Device = "all",
    json: bool = False,
) -> None:
    """Say what sdm finds on this machine: GPUs, driver, compiled kernels, extras, memory, and what stands in the way.

    Kernels compile when they are first needed, which takes seconds to minutes and is kept. --compile does it now.

    Args:
        compile_kernels: Compile the kernels now, for the CPU and every GPU.
        device: Where to compile: cpu, cuda, cuda:N, or all.
        json: Print JSON instead of a table; sizes are in bytes.
    """
    from sdm.cli.machine.facts import facts
    from sdm.core.device import choose_device

    wanted = [] if device == "all" else [str(choose_device(device))]
    found = facts()
    if compile_kernels:
        found["compiled"] = {
            name: _compile(name) for name in wanted or ["cpu", *(gpu["device"] for gpu in found["gpus"])]
        }
    if json:
        print(as_json.dumps(found, indent=2))
        return
    _print(found)


def _compile(device: str) -> float:
    """Seconds that it took."""
    from sdm.cli.machine.compile_ahead import compile_ahead
    from sdm.kernels.launches.compiling import keep_silent

    keep_silent()
    begun = time.perf_counter()

    def say(name: str, done: int, total: int) -> None:
        if done < total:
            print(f"sdm: {device}, {done + 1} of {total}: {name}", file=sys.stderr, flush=True)

    compile_ahead(device, say)
    return round(time.perf_counter() - begun, 1)


def _print(found: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in _rows(found):
        table.add_row(name, Text(value, overflow="fold"))
    console.print(table)
    _print_extras(console, found["extras"])
    for device, seconds in found.get("compiled", {}).items():
        console.print(f"kernels for {device} are compiled ({seconds} s)", style="green")
    for problem in found["problems"]:
        console.print(f"- {problem}", style="yellow", markup=False, soft_wrap=True)
    if not found["problems"]:
        console.print("nothing stands in the way", style="green")


def _rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    from sdm.core.device import gibibytes

    versions, cpu, cuda, cache = found["versions"], found["cpu"], found["cuda"], found["cache"]
    rows = [
        ("versions", ", ".join(f"{name} {number}" for name, number in versions.items())),
        ("system", found["system"]),
        ("CPU", f"{cpu['cores']} cores, {cpu['threads']} threads for kernels, {gibibytes(cpu['free_memory'])} free"),
    ]
    for gpu in found["gpus"]:
        free = f"{gibibytes(gpu['free_memory'])} of {gibibytes(gpu['memory'])} free"
        rows.append((gpu["device"], f"{gpu['name']}, compute capability {gpu['compute_capability']}, {free}"))
    if not found["gpus"]:
        rows.append(("GPU", "none that torch can use: the CPU computes"))
    built = "without CUDA" if cuda["of_torch"] is None else f"for CUDA {cuda['of_torch']}"
    rows.append(("CUDA", f"torch is built {built}; driver {cuda['driver'] or 'not found'}"))
    size = f"{gibibytes(cache['bytes'])}; {gibibytes(cache['free_space'])} free on its disk"
    counts = f"{cache['for_cpu']} modules for the CPU, {cache['for_gpu']} for GPUs"
    rows.append(("compiled kernels", f"{counts} in {cache['folder']} ({size})"))
    if not cache["for_cpu"] and not cache["for_gpu"]:
        rows.append(("", "none yet: the first map compiles them, or sdm doctor --compile"))
    return rows


def _print_extras(console: Console, extras: list[dict[str, Any]]) -> None:
    from rich.table import Table

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for extra in extras:
        state = "missing: " + ", ".join(extra["missing"]) if extra["missing"] else "installed"
        table.add_row(f"\\[{extra['name']}]", state, extra["use"])
    console.print('\nextras, each by pip install ".\\[NAME]" in a clone')
    console.print(table)
    console.print()
