"""Pictures by sphere tracing."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from sdm.deepsdf import DeepSDF, interpolation_strip, local, render, save_picture, sphere_trace
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.errors import SDMError


@pytest.fixture
def ball() -> DeepSDF:
    settings = local(width=16, layers=2, global_size=4, grids=((2, 2),), frequencies=1)
    return DeepSDF(settings, AutoDecoder(settings, 1).decoder, torch.zeros(2, settings.code_size), [], [])


def test_rays_meet_a_ball_where_it_is(ball: DeepSDF) -> None:
    across = torch.linspace(-0.9, 0.9, 37)
    origins = torch.stack([across, torch.zeros(37), torch.full((37,), 2.0)], 1)
    points, hit = sphere_trace(ball, ball.codes[0], origins, torch.tensor([0.0, 0.0, -1.0]).expand(37, 3))
    clear = (across.abs() - 0.5).abs() > 0.02
    assert torch.equal(hit[clear], (across.abs() < 0.5)[clear])
    inner = across.abs() < 0.45
    assert torch.allclose(points[inner, 2], (0.25 - across[inner] ** 2).sqrt(), atol=3e-3)


def test_the_picture_of_a_ball_is_a_disc_on_white(ball: DeepSDF) -> None:
    picture = render(ball, ball.codes[0], size=64)
    covered = (picture < 1).any(-1)
    assert covered.float().mean().item() == pytest.approx(torch.pi * 0.25 / 4, abs=0.015)
    assert picture.min() >= 0
    assert picture.max() <= 1
    assert not covered[:12].any()
    assert covered[32, 32]


def test_a_strip_has_its_ends(ball: DeepSDF, tmp_path: Path) -> None:
    strip = interpolation_strip(ball, ball.codes[0], ball.codes[1], count=3, size=16)
    assert strip.shape == (16, 48, 3)
    assert torch.equal(strip[:, :16], render(ball, ball.codes[0], size=16))
    save_picture(strip, tmp_path / "strip.png")
    assert (tmp_path / "strip.png").read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in tmp_path.iterdir()] == ["strip.png"]


def test_bad_input_is_said(ball: DeepSDF) -> None:
    with pytest.raises(SDMError, match="a strip of 1 pictures has no ends"):
        interpolation_strip(ball, ball.codes[0], ball.codes[1], count=1)
    with pytest.raises(SDMError, match="a picture of 0 pixels"):
        render(ball, ball.codes[0], size=0)
