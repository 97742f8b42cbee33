"""A template is laid again where it missed a part; faces that turned over are put right, and the rest stays."""

from __future__ import annotations

import pytest
import torch

from sdm.core.mesh import TriangleMesh
from sdm.shapes.cube_sphere import cube_surface, unit_sphere
from sdm.shapes.models.lay_template import Laid, TemplateLayer


def test_a_fold_is_put_right_and_the_rest_stays():
    cube, faces = cube_surface(12)
    rest = torch.from_numpy(unit_sphere(cube).copy()).float()
    layer = TemplateLayer(TriangleMesh(rest, torch.from_numpy(faces), check=False), "cpu")
    # Bent, so that the patch has something to follow.
    bent = rest * torch.tensor([1.3, 1.0, 0.8])
    bent[:, 0] += 0.3 * rest[:, 2].square()
    folded = bent.clone()
    top = int(rest[:, 2].argmax())
    near = (rest - rest[top]).norm(dim=1) < 0.25
    folded[near] = 2 * bent[top] - bent[near] + torch.tensor([0.0, 0.0, 0.1])
    assert layer._turned(folded, rest, layer._local_rotations(rest, folded), 0.0).any()

    right = layer._turned_back(folded, rest)

    assert not layer._turned(right, rest, layer._local_rotations(rest, right), 0.0).any()
    assert (right - bent).norm(dim=1).max() < 0.15
    assert torch.equal(right[rest[:, 2] < 0], bent[rest[:, 2] < 0])


def test_what_is_not_turned_is_not_touched():
    cube, faces = cube_surface(6)
    rest = torch.from_numpy(unit_sphere(cube).copy()).float()
    layer = TemplateLayer(TriangleMesh(rest, torch.from_numpy(faces), check=False), "cpu")
    bent = rest * torch.tensor([1.3, 1.0, 0.8])
    assert torch.equal(layer._turned_back(bent, rest), bent)


def laid(distance: float, most: float, turned: int = 0) -> Laid:
    return Laid(torch.zeros(1, 3), distance, most, turned, 0)


@pytest.mark.parametrize(
    ("results", "chosen"),
    [
        ([laid(0.1, 0.05)], 0),
        ([laid(0.5, 1.0), laid(0.1, 0.05)], 1),
        ([laid(0.5, 1.0), laid(0.4, 1.0), laid(0.45, 1.0)], 1),
        ([laid(0.5, 1.0), laid(0.1, 0.05, turned=2)], 0),
    ],
)
def test_a_template_that_missed_a_part_is_laid_again(monkeypatch, results, chosen):
    """Of a unit cube, whose diagonal is 1.73: further than a twentieth of that is a part that was missed."""
    cube, faces = cube_surface(4)
    mesh = TriangleMesh(torch.from_numpy(cube.copy()).float() / 2, torch.from_numpy(faces), check=False)
    layer = TemplateLayer(mesh, "cpu")
    seeds: list[int] = []

    def once(target, seed):
        seeds.append(seed)
        return results[len(seeds) - 1]

    monkeypatch.setattr(layer, "_laid_once", once)
    assert layer.lay(mesh, seed=5) is results[chosen]
    assert len(set(seeds)) == len(results)
    assert seeds[0] == 5
