"""A GPU made ready in a thread of its own, while the modules of a command are imported.

A process's first work on a GPU makes its context and loads each of torch's kernels as it is first called: milliseconds
of the driver, without Python's lock. A command for one mesh would wait for all of that after its imports.
"""

from __future__ import annotations

import contextlib
import threading

CPU = "cpu"


def begin(device: str) -> threading.Thread | None:
    """Make a device ready from now on; the thread that does it, or None of a CPU.

    Args:
        device: As commands take it: auto, cpu, cuda or cuda:N. Where there is none, who uses it says so.
    """
    if device == CPU:
        return None
    # By this thread: two that import torch at once would wait for each other's modules.
    import torch  # noqa: F401

    thread = threading.Thread(target=_touch, args=(device,), name="sdm early device")
    thread.start()
    return thread


def _touch(device: str) -> None:
    # Whatever is wrong with the device is said by the command's own call.
    with contextlib.suppress(Exception):
        import torch

        if not torch.cuda.is_available():
            return
        where = torch.device("cuda" if device == "auto" else device)
        # The kinds of kernels that maps, floods, surfaces and their reports begin with.
        values = torch.ones(8, 3, device=where)
        numbers = torch.arange(8, device=where)
        ((values == 0) & values.signbit()).any().logical_not()
        values.masked_fill_(values < 0, 1.0).amin(0)
        values.double().abs().amax(0).sub(1.0).mul(2.0).add(values[0].double())
        torch.linalg.cross(values.double(), values.double()).norm(dim=1).div(2.0).sqrt()
        torch.nn.functional.normalize(values, dim=1)
        for counts in (numbers, numbers.int()):
            counts.cumsum(0, dtype=torch.int32)
            counts.sum()
            values[counts.long()]
        torch.searchsorted(values[:, 0].double().cumsum(0), values[:, 0].double(), right=True).clamp(max=3)
        torch.where(numbers > 3, numbers, 0)[numbers] = numbers
        torch.stack([numbers, torch.cat([numbers[:4], numbers[4:]])]).float().mean().max()
        torch.cuda.synchronize(where)
