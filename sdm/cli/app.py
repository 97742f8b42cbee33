"""Entry of the command line: from words to a command, and from an error to one sentence and an exit code."""

from __future__ import annotations

import functools
import gc
import importlib
import io
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

from sdm.cli.commands.bench import program
from sdm.cli.common import examples
from sdm.cli.common.addresses import with_stand_ins
from sdm.cli.common.argument_types import NUMBERS
from sdm.cli.common.compile_notice import announce_compiling
from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.numbers import joined
from sdm.cli.common.printed_line import print_line
from sdm.cli.common.renamed_options import renamed
from sdm.cli.common.termination import Terminated, raised_termination
from sdm.cli.common.usage_error import UsageError, no_command, sentence
from sdm.cli.told_warnings import warnings_in_a_line
from sdm.runtime import torch_libraries

# In the order of the help text.
COMMANDS = (
    "inspect",
    "compute",
    "edt",
    "surface",
    "watertight",
    "generate",
    "sample",
    "split",
    "family",
    "shape-model",
    "train",
    "predict",
    "fit",
    "encode",
    "decode",
    "segment",
    "evaluate",
    "view",
    "explore",
    "demo",
    "doctor",
    "completion",
    "bench",
)

# Of commands whose module lies elsewhere, or is not called like them.
MODULES = {
    "view": "viewing.view",
    "explore": "viewing.explore",
    "family": "families.family_commands",
    "shape-model": "families.model_commands",
    "doctor": "setup.doctor",
    "completion": "setup.completion",
}

DESCRIPTION = """Exact signed distance maps of triangle meshes, negative inside. Lengths are in the mesh's own unit."""

DONE = 0
USER_ERROR = 2
INTERRUPTED = 130
BROKEN_PIPE = 141
TERMINATED = 143

# Importing torch and Warp makes a million objects that stay. Looking through them for garbage as often as Python does
# takes a quarter of a second of the start.
GARBAGE_THRESHOLDS = (10_000, 10, 10)

# With --resume these go on where they were interrupted.
RESUMABLE = (["compute"], ["generate"], ["sample"], ["watertight"], ["train", "deepsdf"], ["train", "segmentation"])
# Commands that launch kernels, which compile at the first time.
WITH_KERNELS = (
    "compute",
    "edt",
    "surface",
    "watertight",
    "generate",
    "sample",
    "split",
    "family",
    "shape-model",
    "train",
    "fit",
    "encode",
    "decode",
    "view",
    "explore",
    "demo",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The words after `sdm`; those of this process if not given.

    Returns:
        0 if all went well; 2 for what is the user's to mend, said in one sentence on stderr; 130 if interrupted, 143 if
        terminated.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    _open_streams()
    thresholds = gc.get_threshold()
    gc.set_threshold(*GARBAGE_THRESHOLDS)
    try:
        if words and words[0] in WITH_KERNELS and not {"-h", "--help"} & set(words):
            torch_libraries.begin()
        with raised_termination(), with_stand_ins(words) as local:
            command = _parse(local)
            if words and words[0] in WITH_KERNELS and command is not _nothing:
                announce_compiling()
            with warnings_in_a_line():
                code = _told_by_addresses(command)
        sys.stdout.flush()
    except UsageError as error:
        return _complain(str(error))
    except Terminated:
        print("sdm: terminated", file=sys.stderr)
        return TERMINATED
    except KeyboardInterrupt:
        print(f"sdm: interrupted{_way_on(words)}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read the output has gone; the interpreter must not fail again as it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except SystemExit as stop:
        # rich leaves so where its reader has gone, and has closed stdout.
        if isinstance(stop.__context__, BrokenPipeError):
            return BROKEN_PIPE
        raise
    except Exception as error:
        reason = sentence_of(error)
        if reason is None:
            raise
        return _complain(reason)
    finally:
        gc.set_threshold(*thresholds)
    return DONE if code is None else code


def _way_on(words: list[str]) -> str:
    """Words about going on with an interrupted command, to end a sentence; none where it only begins again."""
    goes_on = words[:1] in RESUMABLE or words[:2] in RESUMABLE
    return f"; the same command{'' if '--resume' in words else ' with --resume'} goes on from there" if goes_on else ""


def _told_by_addresses(command: Callable[[], int | None]) -> int | None:
    """Run a command whose errors are told while it is known which paths stand for addresses."""
    try:
        return command()
    except BrokenPipeError:
        raise
    except Exception as error:
        reason = sentence_of(error)
        if reason is None:
            raise
        return _complain(reason)


def _open_streams() -> None:
    """Make stdout and stderr take whatever is printed: a result must not be lost with the line that tells of it."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # Closed by whoever started this. A file that opens next would have the number 1 or 2, and native libraries
            # would print into it.
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            # Names of files may have letters that the terminal's encoding has not.
            stream.reconfigure(errors="backslashreplace")


def _complain(sentence: str) -> int:
    print_line(f"sdm: {sentence}", error=True)
    return USER_ERROR


def _parse(words: list[str]) -> Callable[[], int | None]:
    """The command that `words` ask for, with its arguments, not yet run."""
    import tyro
    from tyro.extras import subcommand_cli_from_dict

    if words[:1] == ["--version"]:
        return _print_version
    # As a path it would be the folder one is in. `--mirrors ""` is no axis.
    if any(word == "" and before != "--mirrors" for before, word in zip(["", *words], words, strict=False)):
        raise UsageError("an argument is empty, as a variable of the shell that is not set gives; see sdm --help")
    brief = not (words and words[0] in COMMANDS)
    if words and brief and not words[0].startswith("-"):
        raise UsageError(f"{no_command(words[0], COMMANDS)}; see sdm --help")
    if words[:1] == ["bench"] and (found := program(words[1:])) is not None:
        return found
    if (former := renamed(words)) is not None:
        raise UsageError(f"{former}; see sdm {' '.join(words[:2])} --help")
    commands = {}
    # The one that is asked for; with another, as of one alone tyro makes no command.
    for name in COMMANDS if brief else (words[0], "demo" if words[0] != "demo" else "view"):
        module = importlib.import_module(f"sdm.cli.commands.{MODULES.get(name, name)}")
        commands[name] = _later(getattr(module, name.replace("-", "_")), brief)
    said = io.StringIO()
    try:
        with redirect_stderr(said), NUMBERS:
            return subcommand_cli_from_dict(
                commands,
                prog="sdm",
                description=DESCRIPTION,
                args=joined(words),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if stop.code in (None, 0):
            if {"-h", "--help"} & set(words):
                print(examples.of_help(words), end="")
            return _nothing
        command = "sdm" if brief else f"sdm {words[0]}"
        raise UsageError(f"{sentence(said.getvalue())}; see {command} --help") from None


def _later(command: Callable[..., int | None], brief: bool) -> Callable[..., Any]:
    """A command that its parser prepares and does not run, so that errors of the two are told apart.

    `brief` leaves the first paragraph of its help, for the list of all commands.
    """

    @functools.wraps(command)
    def prepare(*args: Any, **kwargs: Any) -> Callable[[], int | None]:
        return functools.partial(command, *args, **kwargs)

    if brief:
        prepare.__doc__ = (command.__doc__ or "").split("\n\n")[0]
    return prepare


def _nothing() -> None:
    return None


def _print_version() -> None:
    import sdm

    print(f"sdm {sdm.__version__}")
