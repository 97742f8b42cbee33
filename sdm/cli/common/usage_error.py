"""Mistakes on the command line, as one sentence each."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence

# What tyro draws around its messages, on terminals with such letters and on others.
FRAME = re.compile(r"\x1b\[[0-9;]*m|^[│|]|[│|]$")
RULE = re.compile(r"^[─╭╰]|^---")
# With such letters the title is part of the frame; with others it is a line of its own.
CORNER = "╭"
# The beginning of its second part, where it has an option to propose.
PROPOSAL = "Perhaps you meant"
# What Python and tyro say of values of another type, and how a user would.
VALUES = (
    (re.compile(r"invalid literal for int\(\) with base 10: (.*)"), r"takes a whole number, not \1"),
    (re.compile(r"could not convert string to float: (.*)"), r"takes a number, not \1"),
    (re.compile(r"no type matching N could be instantiated from \[(.*)\]"), r"takes a whole number, not \1"),
    (re.compile(r"no type matching X could be instantiated from \[(.*)\]"), r"takes a number, not \1"),
    (re.compile(r"no type matching (\S+) could be instantiated from \[(.*)\]"), r"takes \1, not \2"),
)
PARSING = re.compile(r"Error parsing (\S+): (.*)")
WITHOUT_VALUE = re.compile(r"Missing value for argument '(.*?)'\..*")
SURPLUS = "Unrecognized options: "
CHOICE = re.compile(r"invalid choice (.*) for argument '(.*)'\. Expected one of \((.*?),?\)")


class UsageError(Exception):
    """A command line that is no command's."""


def sentence(drawn: str) -> str:
    """The text of tyro's message, without its frame; of what follows its first part, the option that it proposes."""
    parts: list[list[str]] = [[]]
    for line in drawn.splitlines():
        text = FRAME.sub("", FRAME.sub("", line).strip()).strip()
        if not text or RULE.match(text):
            parts += [[]] if parts[-1] else []
        else:
            parts[-1].append(text)
    whole = [" ".join(part).rstrip(".") for part in parts if part]
    if CORNER not in drawn and len(whole) > 1:
        whole = whole[1:]
    if not whole:
        return "the arguments cannot be understood"
    meant = re.search(rf"{PROPOSAL}.*?(--[\w-]+)", " ".join(whole[1:]))
    # tyro proposes an option of another command too, which has the very name.
    if meant and re.search(rf"{meant[1]}(?![\w-])", whole[0]):
        meant = None
    return _in_plain_words(whole[0]) + (f"; perhaps {meant[1]} is meant" if meant else "")


def _in_plain_words(said: str) -> str:
    chosen = CHOICE.fullmatch(said)
    if chosen is not None:
        # tyro has them in no order, and among them that nothing is given.
        known = sorted(word.strip(" '") for word in chosen[3].split(","))
        return f"{chosen[2]} takes one of {', '.join(word for word in known if word != 'None')}, not {chosen[1]}"
    if alone := WITHOUT_VALUE.fullmatch(said):
        return f"{alone[1]} needs a value"
    # Of words without an option, too.
    if said.startswith(SURPLUS):
        return _of_surplus(said.removeprefix(SURPLUS).split(", "))
    found = PARSING.fullmatch(said)
    if found is None:
        return said
    option, why = found.groups()
    for pattern, words in VALUES:
        if pattern.search(why):
            return f"{option} {pattern.search(why).expand(words)}"  # type: ignore[union-attr]
    return f"{option}: {why}"


def _of_surplus(words: Sequence[str]) -> str:
    options = [word for word in words if word.startswith("-")]
    if options:
        return f"there is no option {' and no '.join(options)}"
    return f"one argument too many: {words[0]}" if len(words) == 1 else f"arguments too many: {', '.join(words)}"


def no_command(word: str, commands: Sequence[str]) -> str:
    """Sentence about a command that is not there, with the one that may have been meant."""
    near = difflib.get_close_matches(word, commands, n=1)
    meant = f"; did you mean {near[0]}" if near else f": use one of {', '.join(commands)}"
    return f"there is no command {word}{meant}"
