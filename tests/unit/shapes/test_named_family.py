"""Families by name: registered, of a user's file, of a shape model's file; what is refused, in one sentence."""

from __future__ import annotations

import pickle

import pytest
import torch

from sdm.cli import main
from sdm.dataset.family_registry import describe, family_from
from sdm.errors import SDMError
from sdm.shapes import StatisticalShape, family_record, load_family
from sdm.shapes.family_check import check_family
from sdm.shapes.named_family import differs_from

CODE = '''
import pathlib
import torch
from sdm.shapes import Ellipsoid, Family, Parameter

pathlib.Path("ran.txt").touch()

class Ball(Family):
    """Balls; `twice` adds another that cuts the first."""
    parameters = (Parameter("r", 1.0, 2.0, "mm"),)

    def __init__(self, twice=False, wrong=False):
        made = Ellipsoid.example()
        theta = torch.tensor([[1.0, 1.0, 1.0] + [0.0] * (len(made.parameters) - 3)])
        self.points, self.triangles, self.wrong = made.vertices(theta)[0], made.triangles, wrong
        if twice:
            self.triangles = torch.cat([self.triangles, self.triangles + len(self.points)])
            self.points = torch.cat([self.points, self.points + 0.3])

    def vertices(self, theta):
        r = theta[:, :, None]
        return self.points.to(theta) * (r + 3 * (r - r.detach()) if self.wrong else r)

class Doubles(Ball):
    parameters = (Parameter("r", 1.0, 2.0, "mm"),)
    def vertices(self, theta):
        return super().vertices(theta).double()

class Own(Ball):
    """Sets `faces`, not `triangles`."""
    def __init__(self):
        super().__init__()
        self.own = self.triangles
        del self.triangles
    faces = property(lambda self: self.own)

def crossing():
    return Ball(twice=True)

def wrong():
    return Ball(wrong=True)

ready = Ball()
number = 3
'''


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ball.py").write_text(CODE)
    (tmp_path / "broken.py").write_text("def f(:\n")
    (tmp_path / "leaves.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "junk.npz").write_bytes(b"PK junk")
    StatisticalShape.example().save("model.npz")
    return tmp_path


@pytest.mark.parametrize("name", ["cochlea", "ball.py:Ball", "ball.py:ready", "model.npz"])
def test_a_record_knows_its_family(place, name):
    family = load_family(name)
    record = family_record(family)
    assert differs_from(load_family(name), record) is None
    assert differs_from(load_family("cuboid"), record) == "name"
    again = pickle.loads(pickle.dumps(family))
    theta = family.sample(2, device="cpu")
    assert torch.equal(again.vertices(theta), family.vertices(theta))


def test_another_formula_is_another_family(place):
    record = family_record(load_family("ball.py:Ball"))
    changed = CODE.replace("self.points.to(theta) * (", "self.points.to(theta) * 1.01 * (")
    (place / "ball.py").write_text(changed)
    assert differs_from(load_family("ball.py:Ball"), record) == "vertices"


def test_a_record_runs_no_code(place):
    known = describe("ball.py:Ball", {})
    (place / "ran.txt").unlink()
    (place / "ball.py").write_text(CODE + "\n# Another file.")
    with pytest.raises(SDMError, match="run only where you name it"):
        family_from(known, named=False)
    assert not (place / "ran.txt").exists()
    assert family_from(known).name == "ball"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ball.py:Torus", "no family called 'Torus'; it has Ball, Doubles, Own, ready"),
        ("ball.py", "say which family of it"),
        ("ball.py:number", "not a sdm.shapes.Family"),
        ("ball.py:Doubles", "torch.float32 is needed"),
        ("ball.py:Own", "needs `parameters` and `triangles`: AttributeError"),
        ("none.py:Ball", "cannot be read: No such file"),
        ("broken.py:Ball", "cannot be run: SyntaxError"),
        ("leaves.py:Ball", "cannot be run: SystemExit: 3"),
        ("junk.npz", "is not a shape model"),
        ("none.npz", "cannot be read"),
        ("torus", "FILE.py:NAME"),
        ("shape-model", "MODEL.npz"),
    ],
)
def test_what_is_no_family_is_refused_in_a_sentence(place, capsys, name, expected):
    assert main(["family", "check", name]) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1


def test_a_sound_family_is_found_sound(place):
    found = check_family(load_family("model.npz"), samples=3, device="cpu")
    assert found.problems == ()
    assert found.closed == found.outward == 1
    assert found.derivative_error < 1e-3
    assert 0 < found.smallest < found.largest


def test_what_is_wrong_with_a_family_is_found(place, capsys):
    assert main(["family", "check", "ball.py:crossing", "--count", "2", "--device", "cpu"]) == 2
    assert "cuts itself" in capsys.readouterr().err
    found = check_family(load_family("ball.py:wrong"), samples=2, device="cpu")
    assert found.derivative_error > 0.5
    assert "derivatives" in found.problems[0]


def test_a_sheet_has_the_triangles_that_were_asked_for(place, monkeypatch):
    """Also of solids, which cannot be made again from others of their kind."""
    drawn = []
    monkeypatch.setattr("sdm.viz.family_sheet.family_sheet", lambda shapes, *_, **__: drawn.append(len(shapes[0][1])))
    for words in (["cuboid", "--triangles", "200"], ["cuboid"], ["cochlea"], ["cochlea", "--triangles", "900"]):
        assert main(["family", "show", *words, "-o", "sheet.png", "--count", "0"]) == 0
    assert drawn[0] == 192
    assert drawn[1] == len(load_family("cuboid").faces)
    assert abs(drawn[2] - 4000) < 400
    assert abs(drawn[3] - 900) < 200
    assert main(["family", "show", "cuboid", "--triangles", "-3", "-o", "sheet.png"]) == 2


def test_commands_take_each_kind_of_name(place, capsys):
    assert main(["family", "show", "model.npz", "-o", "sheet.png", "--count", "1"]) == 0
    assert (place / "sheet.png").stat().st_size > 10_000
    words = ["--count", "2", "--resolution", "8", "--device", "cpu"]
    assert main(["generate", "ball.py:Ball", "-o", "a.zarr", *words]) == 0
    assert main(["generate", "model.npz", "-o", "b.zarr", *words]) == 0
    capsys.readouterr()
    assert main(["generate", "-o", "a.zarr", "--verify"]) == 0
    assert main(["family", "show", "model.npz", "-o", "sheet.txt"]) == 2
    assert main(["family", "show", "model.npz", "-o", "new.png", "--triangles", "600"]) == 2
    assert "it takes no triangles" in capsys.readouterr().err
