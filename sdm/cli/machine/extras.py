"""Extras of this installation, and which of their packages are there."""

from __future__ import annotations

import re
from importlib import metadata
from typing import NamedTuple

PACKAGE = "warp-sdm"
# Extra -> what a user gets by it. Those of development are not listed.
USES = {
    "formats": "meshes in .dae, .zae, .3mf, .3dxml and .xaml",
    "onnx": "surrogates by ONNX Runtime or OpenVINO, quicker than torch on a CPU",
    "viewer": "sdm view: a map in a window",
    "explore": "sdm explore: shapes, maps and fits in a browser",
    "remote": "meshes, maps and datasets by addresses such as s3://; and s3fs, gcsfs or aiohttp",
    "ray": "--ray of sdm compute, generate, sample and watertight: work shared by several machines",
    "jax": "sdm.jax: distances and maps inside jax.jit",
    "monai": "sdm.monai: distance maps of labels in MONAI's pipelines",
    "torchio": "sdm.torchio: the same in TorchIO's",
    "nnunet": "sdm.nnunet: batchgeneratorsv2 and nnU-Net v2",
    "pyvista": "mesh.sdm of PyVista's surfaces",
    "segmentation": "image and label volumes in HDF5",
    "nuts": "posterior of a fit by the No-U-Turn sampler",
    "tensorboard": "curves of trainings",
}
DEVELOPMENT = frozenset(("dev", "docs", "bench", "gpu-bench", "integrations", "release"))


class Extra(NamedTuple):
    """An extra: its name, its use, and the packages of it that are not installed."""

    name: str
    use: str
    missing: list[str]


def extras() -> list[Extra]:
    """The extras that a user may want and that the installed version has, in the order of `USES`."""
    wanted = packages_of_extras()
    return [
        Extra(name, use, [package for package in wanted[name] if not _installed(package)])
        for name, use in USES.items()
        if name in wanted
    ]


def packages_of_extras() -> dict[str, list[str]]:
    """Extra -> names of its packages, by what the installed package says; empty if it is not installed."""
    found: dict[str, list[str]] = {}
    try:
        lines = metadata.requires(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return {}
    for line in lines:
        of_extra = re.search(r"""extra\s*==\s*["']([^"']+)["']""", line)
        name = re.match(r"[A-Za-z0-9._-]+", line)
        if of_extra and name:
            found.setdefault(of_extra[1], []).append(name[0])
    return found


def _installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True
