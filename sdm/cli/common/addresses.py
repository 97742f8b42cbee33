"""Addresses on a command line: `s3://`, `https://` and others in place of files and folders."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sdm.cli.common.usage_error import UsageError

# Commands that read and write file by file.
COMMANDS = ("inspect", "compute", "edt", "surface", "watertight", "generate", "sample")
# Options whose value is written, and those whose value is no file.
OUTPUTS, OTHERS = ("-o", "--out", "--report"), ("--ray",)


@contextmanager
def with_stand_ins(words: list[str]) -> Iterator[list[str]]:
    """The words of a command, with paths that stand for the addresses among them as long as the block lasts.

    Raises:
        UsageError: A command that takes no addresses, or not with another option.
        FormatError: An address that cannot be opened.
    """
    if not any("://" in word for word in words):
        yield words
        return
    from sdm.io.files.remote import is_remote
    from sdm.io.files.stand_in import stand_ins

    options = [word if word.startswith("-") else before for before, word in zip(["", *words], words, strict=False)]
    pairs = [word.partition("=")[::2] if word.startswith("--") and "=" in word else ("", word) for word in words]
    remote = [
        is_remote(value) and (name or option) not in OTHERS
        for (name, value), option in zip(pairs, options, strict=True)
    ]
    if not any(remote):
        yield words
        return
    if words[0] not in COMMANDS:
        named = next(value for (_, value), there in zip(pairs, remote, strict=True) if there)
        raise UsageError(f"sdm {words[0]} takes files of this machine alone: copy {named} here first")
    clash = next((option for option in ("--ray", "--verify") if option in words), None)
    if clash is not None:
        raise UsageError(f"{clash} takes files of this machine alone, no addresses")
    with stand_ins():
        yield [
            word if not there else f"{name}={_place(value, name)}" if name else _place(value, option)
            for word, (name, value), option, there in zip(words, pairs, options, remote, strict=True)
        ]


def _place(address: str, option: str) -> str:
    from sdm.io.files.stand_in import to_read, to_write
    from sdm.io.meshes.formats import mesh_endings

    if option in OUTPUTS:
        return str(to_write(address))
    endings = mesh_endings()
    return str(to_read(address, later=lambda name: name.lower().endswith(endings)))
