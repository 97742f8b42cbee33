from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
import sysconfig
import warnings
from pathlib import Path

import pytest

import sdm
from sdm.cli import COMMANDS, app, main
from sdm.errors import GridError
from sdm.io.maps.formats import FORMATS

LIGHT = """
import sys, types
# The package itself, whose own imports are another matter, as an empty shell.
shell = types.ModuleType("sdm")
shell.__path__ = [sys.argv[1]]
sys.modules["sdm"] = shell
from sdm.cli import main
for words in (["--help"], ["compute", "--help"], ["inspect", "--help"], ["compute"], ["nonsense"]):
    main(words)
heavy = {"torch", "warp", "trimesh", "scipy", "nibabel", "nrrd", "zarr", "matplotlib", "skimage", "numpy"}
print("HEAVY", sorted(heavy & set(sys.modules)))
"""


def test_help_needs_no_heavy_library(root):
    """Numbers and devices wait until a command runs."""
    program = [sys.executable, "-W", "ignore", "-c", LIGHT, str(root / "sdm")]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    assert main([name, "--help"]) == 0
    said = capsys.readouterr()
    assert f"usage: sdm {name}" in said.out
    assert said.err == ""


def test_the_list_of_commands(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS:
        assert f"• {name}" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["encode"], "SHAPE [SHAPE ...]"),
        (["encode"], "vertices are the points. (required)"),
        (["train", "sdmnn"], "a tenth are from the 625 and from the 16 corners"),
        (["train", "sdmnn"], "a file seven times as large"),
        (["fit"], "anchored near the end by two exact evaluations"),
        (["segment"], "Where nothing, or everything, is foreground there is no such map"),
    ],
)
def test_help_says_what_is_so(words, said, capsys):
    assert main([*words, "--help"]) == 0
    assert said in " ".join(capsys.readouterr().out.replace("│", " ").split())


@pytest.mark.parametrize("name", ["compute", "edt", "surface", "view", "decode", "predict"])
def test_help_names_every_format_of_maps(name, capsys):
    assert main([name, "--help"]) == 0
    said = capsys.readouterr().out
    assert [ending for ending in FORMATS if not re.search(rf"\.{re.escape(ending)}\b", said)] == []


def test_help_tells_units_and_conventions(capsys):
    main(["compute", "--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for words in (
        "negative inside",
        "mesh's own unit",
        "share of the longest edge",
        "cuda:N",
        ".nii.gz",
        "(default: 128)",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "inspect, compute"),
        (["nonsense"], "nonsense"),
        (["inspect"], "MESH"),
        (["inspect", "a", "b"], "b"),
        (["compute", "a.stl"], "--out"),
        (["compute", "a.stl", "-o"], "-o"),
        (["compute", "a.stl", "-o", "x.npz", "--resolution", "many"], "--resolution"),
        (["compute", "a.stl", "-o", "x.npz", "--spacing", "x"], "--spacing takes a number, not 'x'"),
        (["compute", "a.stl", "-o", "x.npz", "--resolution", "64,x"], "--resolution takes a whole number, not 'x'"),
        (["compute", "a.stl", "-o", "x.npz", "--spacing"], "--spacing"),
        (["compute", "a.stl", "-o", "x.npz", "--resoluton", "5"], "perhaps --resolution is meant"),
        (["view", "a.stl", "--resolution", "64.5"], "--resolution takes a whole number, not '64.5'"),
        (["generate", "cuboid", "-o", "x", "--count", "ten"], "--count takes a whole number, not 'ten'"),
        (["comput", "x"], "there is no command comput; did you mean compute"),
        (["xyz"], "there is no command xyz: use one of inspect, compute"),
        (["compute", "a.stl", "-o", "x.npz", "--format", "tif"], "tif"),
        (["compute", "a.stl", "-o", "x.npz", "--orient", "up"], "--orient takes one of auto, keep, parts, not 'up'"),
        (
            ["watertight", "a.stl", "-o", "x", "--format", "x"],
            "--format takes one of glb, obj, off, ply, stl, vtk, vtp,",
        ),
        (["compute", "a.stl", "-o", "x.npz", "--wrong"], "--wrong"),
    ],
)
def test_wrong_arguments_are_one_sentence(words, expected, capsys):
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("sdm: ")
    assert line.endswith("--help")
    assert expected in line
    assert "│" not in line


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_wrong_arguments_whatever_the_terminal_shows(encoding):
    program = [sys.executable, "-m", "sdm", "compute", "a.stl", "-o", "x.npz", "--margin", "wide"]
    done = subprocess.run(
        program, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONIOENCODING": encoding}
    )
    assert done.stderr == "sdm: --margin takes a number, not 'wide'; see sdm compute --help\n"


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"sdm {sdm.__version__}\n"


@pytest.mark.parametrize("name", [*COMMANDS, "train deepsdf", "train sdmnn", "train segmentation"])
def test_help_shows_no_types_of_python(name, capsys):
    assert main([*name.split(), "--help"]) == 0
    said = capsys.readouterr().out
    assert "{None" not in said
    assert "default: None" not in said


def run_instead(monkeypatch, error: BaseException) -> int:
    def fail():
        raise error

    monkeypatch.setattr(app, "_parse", lambda words: fail)
    return main(["x"])


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (GridError("a\nb"), 2, "sdm: a\\nb"),
        (KeyboardInterrupt(), 130, "sdm: interrupted"),
        (MemoryError(), 2, "not enough memory"),
        (OSError(28, "No space left on device", "x.npz"), 2, "x.npz: No space left on device"),
    ],
)
def test_errors_of_commands(error, code, words, monkeypatch, capsys):
    assert run_instead(monkeypatch, error) == code
    said = capsys.readouterr()
    assert len(said.err.splitlines()) == 1
    assert words in said.err


def test_mistakes_of_the_program_are_not_hidden(monkeypatch):
    with pytest.raises(ZeroDivisionError):
        run_instead(monkeypatch, ZeroDivisionError())


def test_out_of_memory_on_a_gpu(monkeypatch, capsys):
    import torch

    assert run_instead(monkeypatch, torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 9 TiB")) == 2
    assert "not enough memory" in capsys.readouterr().err


def test_out_of_memory_on_the_host(monkeypatch, capsys):
    import torch

    with pytest.raises(RuntimeError) as error:
        torch.empty(1 << 60, dtype=torch.uint8)
    assert run_instead(monkeypatch, error.value) == 2
    assert "not enough memory" in capsys.readouterr().err


def test_exit_codes_of_commands(monkeypatch):
    monkeypatch.setattr(app, "_parse", lambda words: lambda: 2)
    assert main(["x"]) == 2
    monkeypatch.setattr(app, "_parse", lambda words: lambda: None)
    assert main(["x"]) == 0


def test_the_program_and_the_module(tmp_path):
    program = Path(sysconfig.get_path("scripts")) / "sdm"
    # The one from a command, the other before it, and before torch is imported.
    for start, said in (
        ([program, "inspect", tmp_path / "no.stl"], "sdm: there is no mesh file"),
        ([sys.executable, "-m", "sdm", "inspekt"], "sdm: there is no command inspekt"),
    ):
        done = subprocess.run(start, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert done.stderr.splitlines()[-1].startswith(said)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sample", "x"], "sdm: interrupted; the same command with --resume goes on from there"),
        (["train", "deepsdf", "x", "--resume"], "sdm: interrupted; the same command goes on from there"),
        (["train", "sdmnn"], "sdm: interrupted"),
        (["edt", "x"], "sdm: interrupted"),
    ],
)
def test_an_interrupted_command_says_how_it_goes_on(words, said, monkeypatch, capsys):
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_parse", lambda _: interrupted)
    assert main(words) == 130
    assert capsys.readouterr().err.splitlines()[-1] == said


def test_an_interrupt_before_the_program_is_read():
    """As Ctrl+C in the first hundredths of a second, while the parser is imported: a line, and no traceback."""
    early = "class Early:\n def find_spec(self, name, *_):\n  if name == 'tyro': raise KeyboardInterrupt"
    code = f"import sys\n{early}\nsys.meta_path.insert(0, Early())\n"
    by_module = "import runpy; runpy.run_module('sdm', None, '__main__')"
    for start in ("from sdm.cli import main; sys.exit(main())", by_module):
        done = subprocess.run([sys.executable, "-c", code + start], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (130, "sdm: interrupted\n")


@pytest.mark.parametrize("talk", ["print", "__import__('rich.console').console.Console().print"])
def test_a_reader_that_leaves_early(talk):
    """As with `sdm ... | head`: no traceback, and not success."""
    code = "import sys; from sdm.cli import app; app._parse = lambda words: talk; sys.exit(app.main())"
    # Three times as much as a pipe holds.
    code = f"talk = lambda: {talk}(*['x' * 60] * 3000); {code}"
    command = f'"{sys.executable}" -W ignore -c "{code}" | true; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 141
    assert "Traceback" not in done.stderr


def bash(command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, env=environment)


def test_a_name_that_the_terminal_cannot_show():
    code = "import sys; from sdm.cli import app; app._parse = lambda words: talk; sys.exit(app.main())"
    code = f"talk = lambda: print('b' + chr(228) + 'll.ply'); {code}"
    done = bash(f'"{sys.executable}" -W ignore -c "{code}"', PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stdout, done.stderr) == (0, "b\\xe4ll.ply\n", "")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams(closed, tmp_path):
    """As with `sdm ... >&-`: no traceback, and what is printed goes into no file."""
    code = "import sys; from sdm.cli import app; app._parse = lambda words: talk; sys.exit(app.main())"
    code = f"talk = lambda: print('x', file=open('{tmp_path}/out', 'w')) or print('y') or 3; {code}"
    done = bash(f'"{sys.executable}" -W ignore -c "{code}" {closed}')
    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert (tmp_path / "out").read_text() == "x\n"


def test_warnings_of_the_library_are_a_line(monkeypatch, capsys):
    from sdm.engine.checks.caller_warning import warn

    monkeypatch.setattr(app, "_parse", lambda words: lambda: warn("ball.ply: it is inside out"))
    assert main(["view"]) == main(["view"]) == 0
    assert capsys.readouterr().err == 2 * "sdm: warning: ball.ply: it is inside out\n"


@pytest.mark.filterwarnings("default")
def test_warnings_of_other_libraries_are_a_line_each(monkeypatch, capsys):
    def talk() -> None:
        for _ in range(2):
            warnings.warn_explicit("no such\nglyph.", UserWarning, str(Path(pytest.__file__).parent / "a.py"), 7)
            warnings.warn_explicit("will go", FutureWarning, str(Path(pytest.__file__).parent / "a.py"), 8)
            logging.getLogger("nobody.listens").warning("odd header")

    monkeypatch.setattr(app, "_parse", lambda words: talk)
    with monkeypatch.context() as patch:
        # pytest's own would hear it first.
        patch.setattr(logging.getLogger(), "handlers", [])
        assert main(["view"]) == 0
    said = "sdm: warning: no such glyph (pytest)\nsdm: warning: odd header (nobody)\n"
    assert capsys.readouterr().err == said


def test_a_kernel_cache_that_cannot_be_written(tmp_path):
    mesh = tmp_path / "one.off"
    mesh.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    program = f'"{sys.executable}" -m sdm compute {mesh} -o {tmp_path}/x.npz --resolution 2 --device cpu'
    done = bash(program, WARP_CACHE_PATH="/dev/null")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("sdm: compiled kernels cannot be kept in /dev/null")
    assert "WARP_CACHE_PATH" in line
    assert [path.name for path in tmp_path.iterdir()] == ["one.off"]
