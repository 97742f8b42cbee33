"""Parts of a glTF document that name others which are not there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

Parts: TypeAlias = dict[str, list[dict[str, Any]]]

# Kinds of parts that triangles are read from, and under which key parts of one kind have the number of another's.
KINDS = "accessors", "bufferViews", "buffers", "meshes", "nodes"
NAMES = ("accessors", "bufferView", "bufferViews"), ("bufferViews", "buffer", "buffers"), ("nodes", "mesh", "meshes")


def what_is_missing(document: Any, *, is_binary: bool) -> Iterator[str]:
    """Faults of a document, in words that follow "cannot be read:". `is_binary`: it is that of a `.glb` file."""
    if not isinstance(document, dict):
        yield "it is damaged, its JSON is no object"
        return
    if any(isinstance(document.get(kind), dict) for kind in KINDS):
        yield "its parts have names in place of numbers, as in glTF 1; export it as glTF 2"
        return
    parts = {kind: document.get(kind, []) for kind in KINDS}
    for kind, some in parts.items():
        if not isinstance(some, list) or not all(isinstance(part, dict) for part in some):
            yield f"it is damaged, its {kind} are no list of objects"
            return
    yield from _of_meshes(parts)
    for kind, name, named in NAMES:
        for at, part in enumerate(parts[kind]):
            yield from _not_there(f"{kind[:-1]} {at}", name, part, named, parts)
    used = [parts["buffers"][view["buffer"]] for view in parts["bufferViews"] if "buffer" in view]
    if not is_binary and not all("uri" in buffer for buffer in used):
        yield "it is damaged, a buffer names no file"


def _of_meshes(parts: Parts) -> Iterator[str]:
    for at, mesh in enumerate(parts["meshes"]):
        primitives = mesh.get("primitives")
        for primitive in primitives if isinstance(primitives, list) else [None]:
            if not isinstance(primitive, dict) or not isinstance(primitive.get("attributes"), dict):
                yield f"it is damaged, mesh {at} has no list of primitives with attributes"
                return
            yield from _not_there(f"mesh {at}", "POSITION", primitive["attributes"], "accessors", parts)
            yield from _not_there(f"mesh {at}", "indices", primitive, "accessors", parts)


def _not_there(owner: str, name: str, part: dict[str, Any], named: str, parts: Parts) -> Iterator[str]:
    number, there = part.get(name), len(parts[named])
    if number is not None and (type(number) is not int or not 0 <= number < there):
        yield f"it is damaged, {owner} has {number!r} as {name}, and there are {there} {named}"
