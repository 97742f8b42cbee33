"""The examples run as a reader would run them, with fewer steps of training; notebooks are in step with them."""

import importlib.util
import json
import re
import sys

import pytest

# These say how good the result is, which takes more steps and shapes than a test has.
STEPS = re.compile(r"^((?:STEPS|SHAPES)\b[^=]*= )[\d_]+", re.MULTILINE)
EXAMPLES = (
    "cnn_on_the_stream",
    "descend_onto_a_surface",
    "fit_a_shape",
    "freeze_a_dataset",
    "many_classes",
    "map_of_a_mesh",
    "monai_pipeline",
    "narrow_band",
    "neural_field",
    "shape_model",
    "surrogate_of_a_family",
    "watertight_from_soup",
)
# Those that need an extra.
NEEDS = {"monai_pipeline": "monai"}


def test_every_example_is_listed(root):
    folder = root / "docs" / "examples"
    assert {path.stem for path in folder.glob("*.py")} == set(EXAMPLES)
    page = (folder / "README.md").read_text()
    assert all(f"]({name}.py)" in page and f"]({name}.png)" in page for name in EXAMPLES)


@pytest.fixture
def pyplot(tmp_path, monkeypatch):
    """matplotlib's, in an empty folder; what a script sets there is taken back."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pyplot.rc_context():
        yield pyplot
    pyplot.close("all")


def fewer_steps(text):
    return STEPS.sub(r"\g<1>4", text)


@pytest.mark.parametrize(
    "name",
    # A template is laid onto a dozen meshes; the quick test of that is in shapes/models/test_build_model.py.
    [pytest.param(name, marks=pytest.mark.slow) if name == "shape_model" else name for name in EXAMPLES],
)
def test_example_leaves_its_picture(name, root, tmp_path, pyplot):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"needs the extra {NEEDS[name]}")
    text = fewer_steps((root / "docs" / "examples" / f"{name}.py").read_text())
    exec(compile(text, f"{name}.py", "exec"), {"__name__": "__main__"})
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert (root / "docs" / "examples" / f"{name}.png").stat().st_size > 10_000


def notebooks(root):
    """The module that makes them; the folder of the site is no package."""
    spec = importlib.util.spec_from_file_location("notebooks", root / "docs" / "site" / "notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_notebooks_are_in_step(root):
    folder, module = root / "docs" / "examples", notebooks(root)
    assert {path.stem for path in folder.glob("*.ipynb")} == set(module.NAMES)
    for name in module.NAMES:
        made = module.notebook(name, (folder / f"{name}.py").read_text())
        assert (folder / f"{name}.ipynb").read_text() == made, f"{name}.ipynb is old: make notebooks"
        assert f"]({name}.ipynb)" in (folder / "README.md").read_text()


@pytest.mark.parametrize("name", ["cnn_on_the_stream", "descend_onto_a_surface"])
def test_notebook_runs_cell_by_cell(name, root, tmp_path, pyplot):
    book = json.loads((root / "docs" / "examples" / f"{name}.ipynb").read_text())
    cells = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 3
    namespace: dict[str, object] = {}
    for number, cell in enumerate(cells):
        exec(compile(fewer_steps(cell), f"{name}, cell {number}", "exec"), namespace)
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_comments_and_blocks_stay_with_their_cell(root):
    script = (
        '"""Doc."""\n\nimport a\n\nimport b\n\n# About x.\nx = 1\nfor i in x:\n    y = i\n\n    z = y\n\n\nlast()\n'
    )
    assert notebooks(root).paragraphs(script) == [
        "import a\n\nimport b",
        "# About x.\nx = 1\nfor i in x:\n    y = i\n\n    z = y",
        "last()",
    ]
