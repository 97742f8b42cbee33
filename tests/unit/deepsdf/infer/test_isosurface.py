"""Surfaces from learned functions: tiles, holes in them, and places in the world."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.deepsdf import DeepSDF, decode_mesh, local, published
from sdm.deepsdf.infer.isosurface import refine
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import GridError, SDMError
from sdm.inspect import inspect_mesh


def ball() -> DeepSDF:
    """The local network before any training: a ball of radius a half."""
    settings = local(width=16, layers=2, global_size=4, grids=((2, 2),), frequencies=1)
    return DeepSDF(settings, AutoDecoder(settings, 1).decoder, torch.zeros(1, settings.code_size), [], [])


@pytest.mark.parametrize("resolution", [16, 50, 64])
def test_only_tiles_near_the_surface_are_evaluated_and_every_sign_is_right(resolution: int) -> None:
    seen = 0

    def function(points: torch.Tensor) -> torch.Tensor:
        nonlocal seen
        seen += len(points)
        return (points - 0.1).norm(dim=1) - 0.4

    values, refined = refine(function, resolution, "cpu")
    axis = torch.linspace(-1, 1, resolution)
    points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1)
    dense = (points - 0.1).norm(dim=-1) - 0.4
    assert values.shape == dense.shape
    clear = dense.abs() > 1e-5
    assert ((values < 0) == (dense < 0))[clear].all()
    near = dense.abs() < 2.0 / resolution
    assert torch.allclose(values[near], dense[near], atol=1e-5)
    if resolution == 64:
        assert seen < 0.7 * resolution**3
        assert not bool(refined.all())


def test_a_surface_that_the_middles_of_tiles_do_not_show_is_followed() -> None:
    """A function whose values are much too large, save at one tile: the sign leads from there to the rest."""

    def steep(points: torch.Tensor) -> torch.Tensor:
        values = (points.norm(dim=1) - 0.6) * 40
        return torch.where(points[:, 0] > 0.5, values / 40, values)

    values, _ = refine(steep, 64, "cpu")
    axis = torch.linspace(-1, 1, 64)
    points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1)
    dense = points.norm(dim=-1) - 0.6
    assert ((values < 0) == (dense < 0))[dense.abs() > 1e-5].all()


def test_the_mesh_is_closed_and_where_the_sphere_is() -> None:
    model, sphere = ball(), UnitSphere((10.0, -20.0, 5.0), 8.0)
    mesh = decode_mesh(model, model.codes[0], sphere=sphere, resolution=96)
    report = inspect_mesh(mesh)
    assert report.closed
    assert report.outward
    distance = np.linalg.norm(mesh.vertices.numpy() - np.array(sphere.centre), axis=1)
    assert np.abs(distance - 4.0).max() < 0.02


def test_bad_input_is_said() -> None:
    model = ball()
    with pytest.raises(SDMError, match=r"has 3 numbers; this model's codes have 20"):
        decode_mesh(model, torch.zeros(3))
    with pytest.raises(GridError, match="resolution of 8 is too low"):
        decode_mesh(model, model.codes[0], resolution=8)


def test_a_code_without_a_surface_is_said() -> None:
    settings = published(width=16, global_size=4)
    network = AutoDecoder(settings, 1).decoder
    with torch.no_grad():
        network.last.bias.fill_(3.0)
    model = DeepSDF(settings, network, torch.zeros(1, 4), [], [])
    with pytest.raises(SDMError, match="no surface in the unit sphere's box"):
        decode_mesh(model, model.codes[0], resolution=16)
