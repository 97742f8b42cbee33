"""Facts about this machine, and what of them stands in the way."""

from __future__ import annotations

import os
import platform
import shutil
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from sdm.cli.machine.extras import extras

# Kernels of a whole installation, compiled for a CPU and a GPU, in bytes, with room to spare.
ROOM_FOR_KERNELS = 1 << 30
# Below this a map of 512^3 and what it takes to make it do not fit.
LITTLE_MEMORY = 2 << 30
# Where Linux shows NVIDIA's driver.
DRIVER = Path("/proc/driver/nvidia/version")


def facts() -> dict[str, Any]:
    """Versions, the CPU, GPUs, Warp's cache, extras and problems; sizes in bytes."""
    import torch
    import warp as wp

    import sdm
    from sdm.core.device import free_memory
    from sdm.kernels.launch import threads

    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    cache = cache_facts(Path(str(wp.config.kernel_cache_dir)))
    found: dict[str, Any] = {
        "versions": {
            "sdm": sdm.__version__,
            "python": platform.python_version(),
            "torch": torch.__version__,
            "warp": wp.__version__,
            "numpy": metadata.version("numpy"),
        },
        "system": platform.platform(),
        "cpu": {
            "cores": os.cpu_count(),
            "threads": threads(),
            "free_memory": free_memory(torch.device("cpu")),
        },
        "cuda": {
            "of_torch": torch.version.cuda,
            "driver": _version(wp.get_cuda_driver_version() if wp.is_cuda_available() else None),
            "driver_file": DRIVER.is_file(),
            "seen_by_warp": wp.get_cuda_device_count() if wp.is_cuda_available() else 0,
        },
        "gpus": [_gpu(number) for number in range(torch.cuda.device_count() if torch.cuda.is_available() else 0)],
        "cache": cache,
        "extras": [extra._asdict() for extra in extras()],
    }
    found["problems"] = problems(found)
    return found


def cache_facts(folder: Path) -> dict[str, Any]:
    """Warp's cache: the folder, its size in bytes, modules of sdm that are compiled, and the space that is left."""
    sizes = _file_sizes(folder)
    own = [path for path in sizes if path.name.startswith("wp_sdm.kernels.")]
    there = next((place for place in (folder, *folder.parents) if place.is_dir()), Path.cwd())
    return {
        "folder": str(folder),
        "bytes": sum(sizes.values()),
        "for_cpu": len({path.parent.name for path in own if path.suffix == ".o"}),
        "for_gpu": len({path.parent.name for path in own if path.suffix in (".cubin", ".ptx")}),
        "free_space": shutil.disk_usage(there).free,
        "writable": os.access(there, os.W_OK),
    }


def _file_sizes(folder: Path) -> dict[Path, int]:
    """Sizes of the files below a folder, in bytes; while another process compiles, some come and go."""
    sizes = {}
    for place, _, names in os.walk(folder):
        for path in (Path(place, name) for name in names):
            with suppress(FileNotFoundError):
                sizes[path] = path.stat().st_size
    return sizes


def problems(found: dict[str, Any]) -> list[str]:
    """A sentence for each thing that stands in the way, with what to do."""
    said = []
    cuda, cache = found["cuda"], found["cache"]
    if cuda["driver_file"] and not found["gpus"]:
        cause = (
            "torch is a build without CUDA: install one with it (pytorch.org/get-started)"
            if cuda["of_torch"] is None
            else "torch finds none: look at nvidia-smi and CUDA_VISIBLE_DEVICES"
        )
        said.append(f"an NVIDIA driver is there, but {cause}; until then the CPU computes")
    if found["gpus"] and cuda["seen_by_warp"] < len(found["gpus"]):
        said.append(
            f"torch sees {len(found['gpus'])} GPUs and Warp {cuda['seen_by_warp']}: Warp's build may want a newer "
            "driver than is installed; update the driver"
        )
    if not cache["writable"]:
        said.append(
            f"Warp's cache {cache['folder']} cannot be written, so that every process compiles the kernels again; "
            "name another folder by WARP_CACHE_PATH"
        )
    elif cache["free_space"] < ROOM_FOR_KERNELS:
        said.append(
            f"the disk of Warp's cache {cache['folder']} is nearly full; make room, or name another folder by "
            "WARP_CACHE_PATH"
        )
    if found["cpu"]["free_memory"] < LITTLE_MEMORY:
        said.append(
            "less than 2 GiB of memory are free: large maps have to be written as .zarr, which goes slab by slab"
        )
    return said


def _gpu(number: int) -> dict[str, Any]:
    import torch

    own = torch.cuda.get_device_properties(number)
    free, total = torch.cuda.mem_get_info(number)
    return {
        "device": f"cuda:{number}",
        "name": own.name,
        "compute_capability": f"{own.major}.{own.minor}",
        "memory": total,
        "free_memory": free,
    }


def _version(pair: Any) -> str | None:
    return None if pair is None else ".".join(str(part) for part in pair)
