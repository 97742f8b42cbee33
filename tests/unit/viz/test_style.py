"""All drawings have one style: letters, lines and colours come from `sdm.viz.style`."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest


def drawing_code(root):
    """Python files that draw, but the style's own."""
    places = [path for top in ("sdm", "bench", "docs") for path in (root / top).rglob("*.py")]
    links = {(root / "sdm" / name) for name in ("bench", "kernels")}
    return [
        path
        for path in places
        if not links & set(path.parents) and path.name != "style.py" and "matplotlib" in path.read_text()
    ]


def test_style_comes_from_one_module(root):
    found = drawing_code(root)
    assert len(found) > 15
    own = [
        str(path)
        for path in found
        if re.search(r"font\.(family|sans-serif)|cmap=\"(RdBu|bwr|seismic|jet)", path.read_text())
    ]
    assert not own


def test_captions_have_no_commit(root):
    """A record knows its commit; a picture that says it is old with every commit."""
    captions = [path for path in (root / "bench").rglob("*.py") if re.search("drawing\\(|sheet\\(", path.read_text())]
    assert len(captions) > 5
    calls = [(path.name, line) for path in captions for line in path.read_text().splitlines() if "drawing(" in line]
    assert not [call for call in calls if "commit" in call[1]]


def test_matplotlib_takes_the_style():
    mpl = pytest.importorskip("matplotlib")
    from sdm.viz import STYLE, colour_map
    from sdm.viz.style import PALETTE

    with mpl.rc_context(STYLE):
        assert [entry["color"] for entry in mpl.rcParams["axes.prop_cycle"]] == list(PALETTE)
    red, blue = colour_map()(0.0), colour_map()(1.0)
    assert red[0] > red[2]
    assert blue[2] > blue[0]


def test_lines_differ_in_lightness_too():
    """Those who tell no hues apart still see which line is which, by lightness of neighbours in the order."""
    from matplotlib.colors import to_rgb

    from sdm.viz.style import BLUE, GREY, OCHRE

    weights = (0.2126, 0.7152, 0.0722)
    lightness = [
        sum(w * c**2.2 for w, c in zip(weights, to_rgb(colour), strict=True)) for colour in (BLUE, GREY, OCHRE)
    ]
    assert all(b - a > 0.05 for a, b in pairwise(lightness))
