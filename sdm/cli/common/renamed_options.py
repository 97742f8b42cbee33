"""Options that had another name once: refused with the name that they have now."""

from __future__ import annotations

from collections.abc import Sequence

# By the words of the command. One meaning has one name in all commands.
RENAMED: dict[tuple[str, ...], dict[str, str]] = {
    ("train", "deepsdf"): {"--shapes": "--batch-size"},
    ("train", "sdmnn"): {"--rate": "--learning-rate"},
    ("train", "segmentation"): {"--batch": "--batch-size"},
    ("family", "check"): {"--samples": "--count"},
}


def renamed(words: Sequence[str]) -> str | None:
    """The sentence about the first option of a command line that has another name now; None if there is none."""
    names = RENAMED.get(tuple(words[:2]), {})
    for word in words[2:]:
        option = word.split("=")[0]
        if option in names:
            return f"{option} is called {names[option]} now"
    return None
