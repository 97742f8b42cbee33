"""Record of the machine, the versions and the commit of a result: a figure without it means little."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

from sdm.bench.common.checkout import checkout


def describe(device: str, packages: tuple[str, ...] = ("warp-lang", "torch", "numpy")) -> dict[str, object]:
    """Device, clocks, versions and commit, for a results file."""
    return {
        "device": device_name(device),
        "clocks": clocks(device),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "versions": {name: version for name in packages if (version := version_of(name)) is not None},
        "commit": commit(),
    }


def version_of(package: str) -> str | None:
    """The installed version of a distribution, None if there is none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def device_name(device: str) -> str:
    """The GPU's or the processor's name."""
    if device.startswith("cuda"):
        import torch

        return torch.cuda.get_device_name(device)
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    found = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(found, platform.processor() or platform.machine())


def clocks(device: str) -> dict[str, str | float]:
    """Clocks in MHz as they are now; on a GPU also the highest ones, the driver and the power limit."""
    if not device.startswith("cuda"):
        info = Path("/proc/cpuinfo")
        lines = info.read_text().splitlines() if info.is_file() else []
        found = [float(line.split(":", 1)[1]) for line in lines if line.startswith("cpu MHz")]
        return {"cpu_mhz": sum(found) / len(found)} if found else {}
    names = {
        "sm_mhz": "clocks.sm",
        "memory_mhz": "clocks.mem",
        "most_sm_mhz": "clocks.max.sm",
        "most_memory_mhz": "clocks.max.memory",
        "power_limit_w": "power.limit",
        "driver": "driver_version",
    }
    number = device.partition(":")[2] or "0"
    words = ["nvidia-smi", f"--id={number}", f"--query-gpu={','.join(names.values())}"]
    try:
        said = subprocess.run(
            [*words, "--format=csv,noheader,nounits"], check=True, capture_output=True, text=True, timeout=20
        )
    except (OSError, subprocess.SubprocessError):
        return {}
    values = [value.strip() for value in said.stdout.strip().splitlines()[0].split(",")]
    return {name: _as_number(value) for name, value in zip(names, values, strict=True)}


def _as_number(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def commit() -> str:
    """The checkout's commit, with `+` if tracked files differ from it; SDM_COMMIT where git cannot know it."""
    if "SDM_COMMIT" in os.environ:
        return os.environ["SDM_COMMIT"]
    root = checkout()
    if root is None:
        # An installed copy may lie inside another project's checkout.
        return "unknown"
    try:
        head = _git(root, "rev-parse", "--short=12", "HEAD").strip()
        changed = _git(root, "status", "--porcelain", "--untracked-files=no", "--", "sdm", "kernels", "bench")
        changed = [line for line in changed.splitlines() if "bench/results/" not in line]
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head + ("+" if changed else "")


def _git(root: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(root), *words], check=True, capture_output=True, text=True).stdout
