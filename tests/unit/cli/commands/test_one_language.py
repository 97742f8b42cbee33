"""The words that commands share: one name, one meaning, one way to say it; and examples that the parser takes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess

import pytest

from sdm.cli import COMMANDS, app, main
from sdm.cli.commands.families.family_commands import FAMILY_COMMANDS
from sdm.cli.commands.families.model_commands import MODEL_COMMANDS
from sdm.cli.commands.train import TRAININGS
from sdm.cli.common.examples import EXAMPLES
from sdm.cli.common.renamed_options import RENAMED

PARTS = {"family": FAMILY_COMMANDS, "shape-model": MODEL_COMMANDS, "train": TRAININGS}
PLACES = [*(name for name in COMMANDS if name not in PARTS)]
PLACES += [f"{name} {part}" for name, parts in PARTS.items() for part in parts]

# What the help of a shared option must say. `--device` of doctor is where to compile, and may be all.
SHARED = {
    "--device": r"auto, cpu, cuda or cuda:N; auto is .*\(default: auto\)|cpu, cuda, cuda:N, or all\. \(default: all\)",
    "--seed": r"[Ww]hole number that .* \(default: 0\)",
    "--resolution": r"^N( \[N N\])? Voxels along .*\(default: \d+\)",
    "--spacing": r"Voxel size in (the mesh's unit|mm)",
    "--resume": r"\(default: False\)",
    "--budget-s": r"^SECONDS (Seconds of training at most|About how many seconds)",
    "--batch-size": r"^N (Maps|Shapes|Patches) of a step\b",
    "--learning-rate": r"^X The highest learning rate\b",
    "--count": r"^N ",
    "--steps": r"^N ",
    "--skip-bad": r"\(default: False\)",
    "--truncate": r"^LENGTH Distances beyond this length become this, with their sign",
    "--hole-size": r"^LENGTH .*narrower .*closed\. \(default: two voxels\)",
}
# Other names for what is in `SHARED`.
OTHER_NAMES = {
    "--batch", "--shapes", "--lr", "--rate", "--epsilon", "--overwrite", "--force", "--output", "--voxels", "--number",
    "--samples", "--budget", "--gpu", "--random-seed", "--voxel-size", "--thickness",
}  # fmt: skip
OPTION = re.compile(r"^ +(?:-\w(?: \S+)+, )?(--[a-z][\w-]*)(.*)$")


def _help(place, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    assert main([*place.split(), "--help"]) == 0
    text = re.sub(r"\x1b\[[0-9;]*m|[│╭╮╰╯─]", " ", capsys.readouterr().out)
    said = {}
    name = None
    for line in text.split("Examples:")[0].splitlines():
        if found := OPTION.match(line):
            name = found[1]
            said[name] = found[2]
        elif name and line.startswith("   "):
            said[name] += " " + line.strip()
        else:
            name = None
    return text, {name: " ".join(words.split()) for name, words in said.items()}


@pytest.mark.parametrize("place", PLACES)
def test_help_speaks_one_language(place, capsys, monkeypatch):
    text, options = _help(place, capsys, monkeypatch)
    assert options or place == "completion"
    assert not OTHER_NAMES & set(options)
    for name, words in options.items():
        assert not re.match(r"(INT|FLOAT|STR|PATH PATH|\{None\})\b", words), f"{name} {words}"
        assert "default: None" not in words, f"{name} {words}"
        if name in SHARED:
            assert re.search(SHARED[name], words), f"{name} {words}"
        if re.match(r"(N|X|LENGTH|SHARE)\b", words):
            # A number says what happens without it, or the command asks for it.
            assert "(" in words or place == "predict" or name == "--count", f"{name} {words}"
    if "--out" in options:
        assert re.search(r"-o \S+, --out", text)
    assert text.rstrip().endswith(EXAMPLES[place][-1])


@pytest.mark.parametrize("training", TRAININGS)
def test_trainings_share_their_words(training, capsys, monkeypatch):
    """Samples of a step, the learning rate and the seconds are called alike, whatever is trained."""
    _, options = _help(f"train {training}", capsys, monkeypatch)
    assert options.keys() >= {"--batch-size", "--budget-s"}
    assert training == "deepsdf" or "--learning-rate" in options


@pytest.mark.parametrize("command", RENAMED, ids=" ".join)
def test_former_names_of_options_are_refused_with_the_new_one(command, capsys, monkeypatch):
    _, options = _help(" ".join(command), capsys, monkeypatch)
    for former, name in RENAMED[command].items():
        assert name in options
        assert former not in options
        for words in ([former, "3"], [f"{former}=3"]):
            assert main([*command, "x", *words]) == 2
            said = capsys.readouterr().err
            assert said == f"sdm: {former} is called {name} now; see sdm {' '.join(command)} --help\n"


@pytest.mark.parametrize("line", [line for place in PLACES for line in EXAMPLES[place]])
def test_examples_are_commands(line):
    """Parsed, not run: their files are the reader's."""
    words = shlex.split(line.split(" > ")[0])
    assert words[0] == "sdm"
    command = app._parse(words[1:])
    assert command.func.__name__.replace("_", "-") == words[1]


def test_examples_are_of_commands():
    assert set(PLACES) <= set(EXAMPLES)


def test_a_shell_completes_commands_and_options(tmp_path, capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert "watertight" in script
    assert "--hole-size" in script
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    (tmp_path / "sdm").write_text(script)
    asked = f'. "{tmp_path / "sdm"}"; COMP_WORDS=(sdm waterti); COMP_CWORD=1; _tyro_sdm; echo "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["watertight"]
