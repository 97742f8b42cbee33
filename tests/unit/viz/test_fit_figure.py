"""Pictures of fits of many parameters: no line of text lies on another."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from sdm.fit.solve.diagnosis import Diagnosis
from sdm.shapes import Parameter
from sdm.viz import fit_figure


def result(count: int, warnings: tuple[str, ...] = ()):
    """A fit of so many parameters, with what a picture asks of it."""
    share = torch.zeros(6, 7, 8)
    share[2:4, 2:5, 2:5] = 1
    posterior = SimpleNamespace(intervals=lambda level: torch.tensor([[-1.0, 1.0]] * (count + 6)))
    return SimpleNamespace(
        share=share, expected=share, posterior=posterior, state=SimpleNamespace(theta=torch.zeros(count)),
        parameters=tuple(Parameter(f"mode{k}", -3.0, 3.0, "sd") for k in range(count)),
        diagnosis=Diagnosis(True, 0.99, 5.0, 0.0, 1.0, 1.0, (), warnings), evaluations={"exact": 3}, seconds=1.0,
    )  # fmt: skip


@pytest.mark.parametrize("count", [1, 4, 13, 64])
def test_lines_are_apart_and_within_their_panel(count, monkeypatch) -> None:
    monkeypatch.setattr(fit_figure, "surface_deviations", lambda *given: torch.tensor([0.5]))
    fit = result(count)
    grid = SimpleNamespace(spacing=(1.0, 1.0, 1.0))
    figure = fit_figure._figure(fit.share, grid, None, fit, "Fit", "mm")
    figure.canvas.draw()
    boxes = [text.get_window_extent() for axes in figure.axes for text in axes.texts]
    assert len(boxes) == 4 + min(count + 1, fit_figure.MOST_LINES)
    for k, box in enumerate(boxes):
        assert box.x1 <= figure.bbox.x1
        assert not any(box.overlaps(other) for other in boxes[k + 1 :])


def test_a_warned_of_width_is_not_drawn() -> None:
    fit = result(2, ("intervals are too narrow",))
    figure = fit_figure._figure(fit.share, SimpleNamespace(spacing=(1.0, 1.0, 1.0)), None, fit, "Fit", "")
    said = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert any("warnings" in line for line in said)
    assert not any("within" in line for line in said)
