"""The examples run as a reader would run them, with fewer steps of training."""

import re
import sys

import pytest

# These say how good the result is, which takes more steps than a test has.
STEPS = re.compile(r"^(STEPS\b[^=]*= )[\d_]+", re.MULTILINE)
EXAMPLES = (
    "descend_onto_a_surface",
    "fit_a_shape",
    "freeze_a_dataset",
    "many_classes",
    "map_of_a_mesh",
    "narrow_band",
    "neural_field",
    "surrogate_of_a_family",
    "watertight_from_soup",
)


def test_every_example_is_listed(root):
    folder = root / "docs" / "examples"
    assert {path.stem for path in folder.glob("*.py")} == set(EXAMPLES)
    page = (folder / "README.md").read_text()
    assert all(f"]({name}.py)" in page for name in EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_leaves_its_picture(name, root, tmp_path, monkeypatch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py"])
    text = STEPS.sub(r"\g<1>3", (root / "docs" / "examples" / f"{name}.py").read_text())
    try:
        exec(compile(text, f"{name}.py", "exec"), {"__name__": "__main__"})
    finally:
        pyplot.close("all")
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
