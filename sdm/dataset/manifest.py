"""Manifest of a dataset: what it was made from, in the attribute `sdm` of its group, with a checksum of itself."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard

from sdm.core.grid import Grid
from sdm.dataset.versions import VERSION, WITH_CHECKSUMS
from sdm.errors import FormatError, GridError
from sdm.stream.sample_maker import DRAWS, FIRST_DRAWS, FIRST_SIGN

KEY = "sdm"
CHECKSUM = "crc32"
COMPRESSIONS = ("zstd", "none")
# Arrays whose length tells of the number of samples.
BY_SAMPLE = ("sdm", "theta")


def sealed(manifest: dict[str, Any]) -> dict[str, Any]:
    """The manifest with its checksum, if its version has one."""
    plain = {key: value for key, value in manifest.items() if key != CHECKSUM}
    return {**plain, CHECKSUM: _checksum(plain)} if plain["version"] >= WITH_CHECKSUMS else plain


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a dataset, with every key that a manifest has, each of its type.

    Raises:
        FormatError: There is none, or it is damaged, or of a newer version of sdm.
    """
    try:
        found = json.loads((folder / "zarr.json").read_text())["attributes"][KEY]
    except (OSError, ValueError, KeyError, TypeError):
        raise FormatError(f"{folder} is not a dataset that sdm generate wrote") from None
    if not isinstance(found, dict):
        raise FormatError(f"{folder} is not a dataset that sdm generate wrote")
    version = found.get("version")
    if _is_whole(version) and version > VERSION:
        raise FormatError(f"{folder} was written by a newer version of sdm: update it to read this dataset")
    # Before the checksum, since these say what is wrong.
    _check(found, _FIELDS, folder, "")
    _check({"draws": FIRST_DRAWS, **FIRST_SIGN, **found["recipe"]}, _RECIPE, folder, "recipe.")
    if found["version"] >= WITH_CHECKSUMS:
        if found.pop(CHECKSUM, None) != _checksum(found):
            raise FormatError(
                f"the manifest of {folder}, in its zarr.json, is not what sdm wrote: get that file again from where "
                "the dataset is from"
            )
    else:
        _check_count(found["count"], folder)
    found["recipe"] = {"draws": FIRST_DRAWS, **FIRST_SIGN, **found["recipe"]}
    return found


def require_draws(manifest: dict[str, Any], folder: Path) -> None:
    """Refuse to make samples for a dataset whose seed stands for other random numbers than here.

    Raises:
        FormatError: It does.
    """
    draws = manifest["recipe"]["draws"]
    if draws != DRAWS:
        raise FormatError(
            f"{folder} holds samples by version {draws} of the random numbers, and this sdm draws version {DRAWS}, "
            "which would be other samples: it can be read, but finish or mend it by the sdm that made it, or generate "
            "it anew"
        )


def _checksum(manifest: dict[str, Any]) -> str:
    text = json.dumps(manifest, sort_keys=True, separators=(",", ":"))
    return f"{zlib.crc32(text.encode()):08x}"


def _check(found: dict[str, Any], fields: dict[str, Callable[[Any], bool]], folder: Path, where: str) -> None:
    for name, fits in fields.items():
        if name not in found:
            raise FormatError(f"the manifest of {folder} is damaged: it has no {where}{name}")
        if not fits(found[name]):
            raise FormatError(f"the manifest of {folder} is damaged: its {where}{name} is {str(found[name])[:60]!r}")


def _check_count(count: int, folder: Path) -> None:
    """Refuse a number of samples that no array has, though there are arrays that can be read."""
    lengths = []
    for name in BY_SAMPLE:
        try:
            lengths.append(json.loads((folder / name / "zarr.json").read_text())["shape"][0])
        # A damaged description is mended after the manifest.
        except (OSError, ValueError, KeyError, TypeError, IndexError):
            continue
    if lengths and count not in lengths:
        raise FormatError(
            f"the manifest of {folder} is damaged: it says {count:,} samples, and its arrays have {lengths[0]}"
        )


def _is_whole(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_count(value: Any) -> bool:
    return _is_whole(value) and value >= 1


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or _is_whole(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_parameter(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"name", "low", "high", "unit"}
        and all(map(_is_text, (value["name"], value["unit"])))
        and all(map(_is_number, (value["low"], value["high"])))
    )


def _is_grid(value: Any) -> bool:
    if not isinstance(value, dict) or value.keys() != {"origin", "spacing", "shape", "direction"}:
        return False
    try:
        Grid(**value)
    except (GridError, TypeError):
        return False
    return True


_FIELDS: dict[str, Callable[[Any], bool]] = {
    "version": _is_count,
    "sign": lambda value: value == "negative inside",
    "recipe": lambda value: isinstance(value, dict),
    "count": _is_count,
    "shard": _is_count,
    "compression": lambda value: value in COMPRESSIONS,
    "parameters": lambda value: isinstance(value, list) and all(map(_is_parameter, value)),
    "transforms": lambda value: isinstance(value, bool),
    "rejected": lambda value: isinstance(value, list),
    "sdm_version": _is_text,
    "device": lambda value: value is None or _is_text(value),
    "source": lambda value: value is None or isinstance(value, dict),
}
_RECIPE: dict[str, Callable[[Any], bool]] = {
    "family": _is_text,
    "fingerprint": _is_text,
    "grid": _is_grid,
    "seed": _is_whole,
    "sampler": _is_text,
    # Not in datasets of the first ones.
    "draws": _is_count,
    "dtype": lambda value: value in ("float32", "float16"),
    "truncate": lambda value: value is None or (_is_number(value) and 0 < value < math.inf),
    "sign": lambda value: value in ("winding", "flood", "none"),
    "hole_size": lambda value: value is None or (_is_number(value) and 0 <= value < math.inf),
}
