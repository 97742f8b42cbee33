"""Repair of a dataset: damaged shards are found and made again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from sdm.core.given_values import as_path
from sdm.core.grid import Grid
from sdm.dataset import layout
from sdm.dataset.family_registry import other_family, with_reference
from sdm.dataset.manifest import read_manifest, require_draws
from sdm.dataset.shard_job import Job
from sdm.dataset.shard_paths import rows_of
from sdm.dataset.writer import remake, version
from sdm.errors import FormatError
from sdm.io.files.lock import alone
from sdm.runtime.sharing.devices import device_kind, devices_for
from sdm.shapes import Family
from sdm.stream import Sampler, as_sampler
from sdm.stream.sample_maker import DTYPES


def damaged(path: str | Path, progress: Callable[[int, int], None] | None = None) -> list[int]:
    """Numbers of the shards of a dataset whose files are not, byte for byte, what was written.

    Args:
        path: The dataset, finished or not. Shards that are not there yet count.
        progress: Called with the number of samples looked at and of all.

    Raises:
        FormatError: It is no dataset.
    """
    folder = as_path(path)
    manifest = read_manifest(folder)
    found = []
    for number in range(layout.shard_count(manifest)):
        if not layout.is_sound(folder, manifest, number):
            found.append(number)
        if progress is not None:
            progress(rows_of(manifest, number)[1], manifest["count"])
    return found


def mend_arrays(path: str | Path) -> list[str]:
    """Write the descriptions of a dataset's arrays (their `zarr.json`) again where they are damaged or gone.

    Args:
        path: The dataset, finished or not.

    Returns:
        The names of the arrays.

    Raises:
        FormatError: It is no dataset, or cannot be written.
    """
    folder = as_path(path)
    try:
        return layout.mend_arrays(folder, read_manifest(folder))
    except OSError as error:
        raise FormatError(f"{folder} cannot be written: {error.strerror or error}") from error


def verify(
    path: str | Path,
    family: Family,
    *,
    sampler: Sampler | str | None = None,
    device: str | torch.device | None = None,
    ray: str | None = None,
    shards: list[int] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[int]:
    """Find the damaged shards of a dataset and make them again; damaged descriptions of its arrays too.

    Args:
        path: The dataset.
        family: The shapes that it was made from.
        sampler: Needed if the dataset's has no name, such as a table.
        device: As of `generate`; of the kind that the dataset was made on.
        ray: As of `generate`.
        shards: Those that are damaged, if that is known.
        progress: As of `generate`.

    Returns:
        The numbers of the shards that were made again.

    Raises:
        FormatError: Not a dataset, or one of another family, sampler, version, random numbers or kind of device, or
            another process writes it.
    """
    folder = as_path(path)
    manifest = read_manifest(folder)
    mend_arrays(folder)
    found = damaged(folder) if shards is None else shards
    if not found:
        return []
    require_draws(manifest, folder)
    recipe = manifest["recipe"]
    devices = ["cpu"] if ray is not None else devices_for(device)
    kind = manifest["device"] if ray is not None else device_kind(devices[0])
    chosen = as_sampler(recipe["sampler"] if sampler is None else sampler)
    for what, there, here in (
        ("the family", recipe["fingerprint"], family.fingerprint),
        ("the sampler", recipe["sampler"], str(chosen)),
        ("the version of sdm", manifest["sdm_version"], version()),
        ("the device", manifest["device"], kind),
    ):
        if there is not None and there != here:
            raise FormatError(
                f"{folder} has {len(found)} damaged shards, but {what} it was made with was {there}, here it is "
                f"{here}: made again they would differ"
            )
    if what := other_family(manifest, {"source": with_reference(family, None)}):
        raise FormatError(
            f"{folder} has {len(found)} damaged shards, but the {family.name} it was made with had other {what}: made "
            "again they would differ"
        )
    grid = Grid(**recipe["grid"])
    dtype = {name: kind for kind, name in DTYPES.items()}[recipe["dtype"]]
    signs = recipe["sign"], recipe["hole_size"]
    job = Job(folder, manifest, family, grid, chosen, recipe["seed"], dtype, recipe["truncate"], *signs)
    with alone(folder):
        remake(job, found, devices, ray, progress)
    return found
