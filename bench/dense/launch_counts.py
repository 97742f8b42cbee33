"""Work that the host queues for a first map: kernels, memsets, sorts, torch's operations, and reads of the device.

    python -m sdm.bench.dense.launch_counts --out launch-counts.json [--names]

A mesh never seen before is mapped on a CPU by the steps that a GPU takes when no recording serves it
(`sdm.engine.first_build`, then `structure_slab`), with a GPU's choices: edges joined on the device, boxes of caps that
begin as small as there, lists in splits and coarse bricks by lists. Each launch is counted once, on one thread. A read
is an operation that makes the host wait for the device: a number taken from a tensor, a shape that depends on content,
a copy to the host. Times are not measured: a launch costs an H100's host some 12 us, a memset or a torch operation 5 to
10, and a read as long as the device is behind (`bench/decisions/0029-first-calls.md`).
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
import warp as wp
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.dirty_meshes.by_code import sheets, torn
from sdm.bench.common.machine import describe
from sdm.bench.common.mesh_formulas import Arrays
from sdm.bench.common.meshes import torus
from sdm.engine import first_build, ops
from sdm.engine.plan_override import plan_override
from sdm.kernels import launch as launches
from sdm.kernels.bvh.tree import depth_for
from sdm.kernels.dense.plan import Workload, make_plan
from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.winding import open_caps
from sdm.topology import device_joining, guesses

GPU_BYTES = 80 << 30
# Operations that wait for the device, by the beginning of their names; views and empty tensors cost no launch.
READS = ("_local_scalar_dense", "nonzero", "masked_select", "_unique", "unique_", "equal", "repeat_interleave")
FREE = (
    frozenset(
        (
            "view",
            "reshape",
            "_reshape_alias",
            "split",
            "slice",
            "select",
            "expand",
            "unsqueeze",
            "squeeze",
            "permute",
            "t",
        )
    )
    | frozenset(
        ("transpose", "alias", "detach", "as_strided", "empty", "empty_strided", "new_empty", "empty_like", "unbind")
    )
    | frozenset(("split_with_sizes", "resize_", "set_", "lift_fresh", "_unsafe_view", "unflatten"))
)


class Counts(TorchDispatchMode):
    """Counts of what is queued while it is entered, by kind and name."""

    def __init__(self) -> None:
        super().__init__()
        self.found: dict[str, Counter[str]] = {
            kind: Counter() for kind in ("kernels", "memsets", "sorts", "torch", "reads", "allocations")
        }

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Count one operation of torch."""
        name = func._schema.name.split("::")[1]
        if name.startswith(READS):
            self.found["reads"][name] += 1
        elif name in ("empty", "new_empty", "empty_strided", "empty_like"):
            self.found["allocations"][name] += 1
        elif name in ("zeros", "zero_", "new_zeros", "zeros_like", "fill_", "full"):
            self.found["memsets"][name] += 1
        elif name not in FREE:
            self.found["torch"][name] += 1
        return func(*args, **(kwargs or {}))

    def totals(self) -> dict[str, int]:
        """Sums by kind."""
        return {kind: sum(names.values()) for kind, names in self.found.items()}


@contextmanager
def as_on_a_gpu(split_length: int) -> Iterator[None]:
    """Choices of a GPU where a CPU has others, on one thread; `split_length` as `PlanOptions` has it."""
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(device_joining, "JOINING_DEVICES", ("cuda", "cpu")))
        stack.enter_context(mock.patch.dict(open_caps.MOST_FIRST, {"cpu": open_caps.MOST_FIRST["cuda"]}))
        # Read by a CPU alone, which measures thick slices otherwise.
        stack.enter_context(mock.patch.object(ops, "scales_of", lambda _, meshes: [1.0] * meshes))
        stack.enter_context(mock.patch.dict(os.environ, {"SDM_NUM_THREADS": "1"}))
        options = {"method": "cells", "split_length": split_length, "list_bricks": True, "slice_factors": (1,)}
        stack.enter_context(plan_override(**options))
        yield


@contextmanager
def counting() -> Iterator[Counts]:
    """Counts of what is queued meanwhile."""
    counts = Counts()
    plain, sort, zero = launches.run, wp.utils.radix_sort_pairs, wp.array.zero_
    listed, copied = torch.Tensor.tolist, torch.Tensor.cpu

    def run(kernel: wp.Kernel, *rest: Any) -> None:
        counts.found["kernels"][kernel.key] += 1
        plain(kernel, *rest)

    def sorted_pairs(*given: Any, **more: Any) -> None:
        counts.found["sorts"]["radix_sort_pairs"] += 1
        sort(*given, **more)

    def zeroed(self: wp.array) -> None:
        counts.found["memsets"]["warp"] += 1
        zero(self)

    # On a CPU neither gets as far as torch's dispatcher.
    def to_list(self: Tensor) -> Any:
        counts.found["reads"]["tolist"] += 1
        return listed(self)

    def to_host(self: Tensor) -> Tensor:
        counts.found["reads"]["cpu"] += 1
        return copied(self)

    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(launches, "run", run))
        stack.enter_context(mock.patch.object(wp.utils, "radix_sort_pairs", sorted_pairs))
        stack.enter_context(mock.patch.object(wp.array, "zero_", zeroed))
        stack.enter_context(mock.patch.object(torch.Tensor, "tolist", to_list))
        stack.enter_context(mock.patch.object(torch.Tensor, "cpu", to_host))
        stack.enter_context(counts)
        yield counts


def first_map(mesh: Arrays, resolution: int) -> Counts:
    """The counts of the first map of a mesh."""
    vertices, faces = (torch.from_numpy(array) for array in mesh)
    grid = sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution)
    work = Workload(len(faces), depth_for(len(faces)), 1, grid.shape, grid.spacing, turned=False)
    with as_on_a_gpu(make_plan(work, GPU_BYTES, PlanOptions()).split_length), torch.no_grad():
        for again in range(2):
            # The first time kernels are compiled, and structs of the workspace made.
            copies = vertices.clone(), faces.clone()
            guesses.last_open.clear()
            with counting() as counts:
                structure, _ = first_build.build_first(*copies)
                ops.structure_slab(structure, grid, 0, grid.shape[0])
            if again:
                return counts
    raise AssertionError


def meshes() -> dict[str, Arrays]:
    """Meshes of a few hundred to 5,000 triangles: closed, torn, of sheets, or each triangle with its own vertices."""
    small, large = torus(400), torus(5000)
    vertices, faces = large
    soup = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    return {
        "closed, 400": small,
        "closed, 5,000": large,
        "closed, 5,000, as an STL file": soup,
        "less 3 %, 5,000": torn(large, 0.03),
        "less 30 %, 400": torn(small, 0.3),
        "less 30 %, 5,000": torn(large, 0.3),
        "60 sheets": sheets(60),
    }


def main() -> None:
    """Print the table, and with `--names` what is in it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=64, help="voxels along each axis")
    parser.add_argument("--names", action="store_true", help="also print each kernel and operation")
    parser.add_argument("--out", type=Path, help="a JSON file")
    given = parser.parse_args()
    rows = {}
    for name, mesh in meshes().items():
        counts = first_map(mesh, given.resolution)
        rows[name] = counts.totals()
        print(f"{name:32}" + "  ".join(f"{kind} {number}" for kind, number in rows[name].items()), flush=True)
        if given.names:
            for kind, names in counts.found.items():
                print(f"    {kind}: " + ", ".join(f"{key} {number}" for key, number in names.items()))
    if given.out:
        json_file.write(given.out, {"machine": describe("cpu"), "resolution": given.resolution, "rows": rows})


if __name__ == "__main__":
    main()
