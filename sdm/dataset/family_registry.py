"""Families by name: a few words that a manifest keeps, so that a dataset can be finished from its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.errors import SDMError, one_line
from sdm.io.files.remote import is_remote
from sdm.io.files.stand_in import address_of, to_read
from sdm.io.files.stand_in import known as known_stand_ins
from sdm.io.meshes.formats import mesh_endings
from sdm.shapes import Family, families, load_family, make_family
from sdm.shapes.named_family import CODE, MODEL, difference, differs_from, family_record

# Those that need no files.
FAMILIES: dict[str, type[Family]] = {name: family for name, family in families.items() if not family.needs_files}
FOLDER = "mesh-folder"


def describe(name: str, options: dict[str, Any]) -> dict[str, Any]:
    """A family by name, or a folder of meshes, with the options that differ from its own; ready for JSON.

    Raises:
        SDMError: There is no such family or folder, or it has no such option.
    """
    given = {key: value for key, value in options.items() if value is not None}
    of_file = _is_file(name)
    if name in FAMILIES or of_file:
        wrong = sorted(set(given) - {"triangles"})
        if wrong:
            raise SDMError(f"--{wrong[0].replace('_', '-')} is for a folder of meshes; {name} does not take it")
        if not of_file:
            return {"family": name, **given}
        return {"file": name, "reference": family_record(load_family(name, **given)), **given}
    if not Path(name).is_dir():
        raise SDMError(
            f"{name} is neither a family ({', '.join(FAMILIES)}, FILE.py:NAME, MODEL.npz) nor a folder of meshes"
        )
    if "triangles" in given:
        raise SDMError("--triangles is for a family; meshes of a folder have their own")
    return {"folder": address_of(Path(name)) or str(Path(name).resolve()), **given}


def family_from(source: dict[str, Any], *, named: bool = True) -> Family:
    """The family that `describe` says.

    Args:
        source: What it gave.
        named: The user named it just now. Of a record that was read from a disk a file of code is never run.

    Raises:
        SDMError: It cannot be made here.
    """
    options = dict(source)
    try:
        if "folder" in options:
            folder = _here(options.pop("folder"))
            if isinstance(options.get("scale"), list):
                options["scale"] = tuple(options["scale"])
            return make_family(FOLDER, folder, skip_bad=True, **options)
        if "file" in options:
            return _of_file(options, named)
        name = options.pop("family", None)
        if not isinstance(name, str) or name not in FAMILIES:
            raise SDMError(f"the dataset's family {name!r} is not one that sdm knows by name: give it")
        return make_family(name, **options)
    # Of options that it has not, or of another type.
    except TypeError as error:
        raise SDMError(f"the dataset's source {source} is no family: {one_line(error)}") from error


def family_of_manifest(manifest: dict[str, Any], given: Family | str | None = None) -> Family:
    """The family that a dataset was made from, from its record or as it is given, and no other one.

    Raises:
        SDMError: The record does not say it, names code and nobody does, or it is another one.
    """
    source = source_of(manifest)
    if given is None:
        if not source.keys() & {"family", "file", "folder"}:
            raise SDMError(
                f"the dataset's record does not say what {manifest['recipe']['family']!r} is: give the family"
            )
        family = family_from(source, named=False)
    else:
        kept = {key: value for key, value in source.items() if key == "triangles"}
        family = load_family(given, **kept)
    recipe, reference = manifest["recipe"], source.get("reference")
    what = differs_from(family, reference) if isinstance(reference, dict) else None
    if what is None and (family.name, family.fingerprint) != (recipe["family"], recipe["fingerprint"]):
        what = "name" if family.name != recipe["family"] else "faces or constants"
    if what is not None:
        raise SDMError(f"{family.name} is not the family that the dataset was made from: other {what}")
    return family


def source_of(manifest: dict[str, Any]) -> dict[str, Any]:
    """Source that a dataset was begun from; nothing where its record does not say it.

    It depends on the sign which meshes of a folder can be used, of which old records tell in the recipe alone.
    """
    source, sign = manifest["source"] or {}, manifest["recipe"].get("sign")
    return {"sign": sign, **source} if "folder" in source and sign not in (None, "winding") else source


def with_reference(family: Family, source: dict[str, Any] | None) -> dict[str, Any] | None:
    """A source with a record of the family's shapes, where it is of the user's code: the package has its version."""
    if type(family).__module__.partition(".")[0] == __name__.partition(".")[0]:
        return source
    return {"reference": family_record(family), **(source or {})}


def other_family(found: dict[str, Any], wanted: dict[str, Any]) -> str | None:
    """The difference of the families of two manifests, in words; None where none is known."""
    one, other = ((manifest.get("source") or {}).get("reference") for manifest in (wanted, found))
    return difference(one, other) if isinstance(one, dict) and isinstance(other, dict) else None


def _here(folder: str) -> str:
    """A folder of meshes, or a stand-in for one at an address."""
    if not is_remote(folder):
        return folder
    known = next((one.place for one in known_stand_ins() if one.address == folder.rstrip("/")), None)
    endings = mesh_endings()
    return str(known or to_read(folder, later=lambda name: name.lower().endswith(endings)))


def _of_file(options: dict[str, Any], named: bool) -> Family:
    name, record = str(options.pop("file")), options.pop("reference", {})
    if not named and name.rpartition(":")[0].lower().endswith(CODE):
        raise SDMError(f"the dataset's family is code, {name}, which is run only where you name it: give it")
    family = load_family(name, **options)
    what = differs_from(family, record if isinstance(record, dict) else {})
    if what is not None:
        raise SDMError(f"{name} is not the family that the dataset was made from any more: other {what}")
    return family


def is_family(name: str) -> bool:
    """True of a name that says a family, and not a folder of meshes."""
    return name in FAMILIES or _is_file(name) or not Path(name).is_dir()


def _is_file(name: str) -> bool:
    return name.rpartition(":")[0].lower().endswith(CODE) or name.lower().endswith((CODE, MODEL))
