"""Codes of unseen shapes, of parts of them, and of noisy points: with a decoder whose answer is known."""

from __future__ import annotations

import pytest
import torch
import trimesh
from torch import Tensor, nn

from sdm import TriangleMesh
from sdm.deepsdf import DeepSDF, Scan, encode_meshes, encode_scan, estimate_codes, half_of, local, published
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import SDMError


class Balls(nn.Module):
    """A code of one number: the ball of that radius."""

    def forward(self, codes: Tensor, points: Tensor) -> Tensor:
        return points.norm(dim=-1) - codes


@pytest.fixture
def balls() -> DeepSDF:
    settings = local(global_size=1, grids=())
    return DeepSDF(settings, Balls(), torch.tensor([[0.3], [0.5]]), [], [])


def ball(radius: float) -> TriangleMesh:
    made = trimesh.creation.icosphere(3, radius)
    return TriangleMesh(made.vertices, made.faces, "ball")


def some(count: int, radius: float, seed: int = 0) -> Tensor:
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    return radius * points / points.norm(dim=1, keepdim=True)


def test_the_codes_of_a_batch_are_found_and_do_not_mix(balls: DeepSDF) -> None:
    spheres = [UnitSphere((0.0, 0.0, 0.0), 2.0)] * 2
    found = encode_meshes(balls, [ball(0.5), ball(1.2)], steps=200, points=300, spheres=spheres)
    assert [float(f.code) for f in found] == pytest.approx([0.25, 0.6], abs=3e-3)
    alone = encode_meshes(balls, [ball(0.5)], steps=200, points=300, spheres=spheres[:1])
    assert float(alone[0].code) == pytest.approx(float(found[0].code), abs=1e-3)


def test_half_of_a_surface_with_normals_is_enough(balls: DeepSDF) -> None:
    points = some(1000, 0.4)
    seen = half_of(points, torch.tensor([0.0, 0.0, 1.0]))
    assert int(seen.sum()) == 500
    assert points[seen, 2].min() >= points[~seen, 2].max()
    found = encode_scan(balls, points[seen], points[seen], sphere=UnitSphere((0.0, 0.0, 0.0), 1.0), steps=200)
    assert float(found.code) == pytest.approx(0.4, abs=2e-3)


def test_noisy_points_without_normals_are_enough_and_place_and_size_come_back(balls: DeepSDF) -> None:
    noise = 0.01 * torch.randn(3000, 3, generator=torch.Generator().manual_seed(5))
    sphere = UnitSphere((5.0, 6.0, 7.0), 10.0)
    points = sphere.from_unit(some(3000, 0.45) + noise)
    found = encode_scan(balls, points, sphere=sphere, steps=200)
    assert float(found.code) == pytest.approx(0.45, abs=5e-3)
    assert found.sphere == sphere


def test_a_strong_prior_pulls_codes_to_the_mean_of_the_training_and_the_papers_to_zero(balls: DeepSDF) -> None:
    scan = Scan(some(200, 0.7))
    weak, strong = (float(estimate_codes(balls, scan, steps=100, prior=p).codes) for p in (0.0, 100.0))
    assert weak == pytest.approx(0.7, abs=0.01)
    assert strong == pytest.approx(0.4, abs=0.01)
    paper = DeepSDF(published(global_size=1), Balls(), balls.codes, [], [])
    assert abs(float(estimate_codes(paper, scan, steps=400, prior=100.0).codes)) < 0.02


def test_a_scan_may_be_lists() -> None:
    points, normals = some(200, 0.7), some(200, 1.0)
    for some_of in (lambda x: x, lambda x: x[None].expand(2, -1, -1)):
        one = Scan(some_of(points), some_of(normals))(0)
        other = Scan(some_of(points).tolist(), some_of(normals).tolist())(0)
        assert torch.equal(one.points, other.points)
        assert torch.equal(one.values, other.values)
    with pytest.raises(SDMError, match=r"200, 3.* points and .*199, 3.* normals"):
        Scan(points.tolist(), normals[1:].tolist())


@pytest.mark.parametrize("length", [1e-30, 1e30])
def test_normals_of_a_scan_may_have_any_length(length: float) -> None:
    points, normals = some(200, 0.7), some(200, 1.0)
    assert torch.allclose(Scan(points, length * normals)(0).points, Scan(points, normals)(0).points, atol=1e-6)


def test_the_decoder_stays_what_it_is() -> None:
    settings = local(width=16, layers=2, global_size=4, grids=())
    from sdm.deepsdf.networks.decoders import make_decoder

    model = DeepSDF(settings, make_decoder(settings), torch.zeros(1, 4), [], [])
    before = {k: v.clone() for k, v in model.decoder.state_dict().items()}
    estimate_codes(model, Scan(some(200, 0.4)), steps=3)
    assert all(torch.equal(before[k], v) for k, v in model.decoder.state_dict().items())


def test_steps_take_other_points_and_the_same_again_for_the_same_step() -> None:
    scan = Scan(some(1000, 0.4), count=50)
    assert torch.equal(scan(3).points, scan(3).points)
    assert not torch.equal(scan(3).points, scan(4).points)


def test_bad_scans_are_said(balls: DeepSDF) -> None:
    with pytest.raises(SDMError, match="the scan has 99 points; at least 100 are needed"):
        encode_scan(balls, some(99, 0.4))
    with pytest.raises(SDMError, match="the scan has 0 points; at least 100 are needed"):
        encode_scan(balls, torch.zeros(0, 3))
    broken = some(200, 0.4)
    broken[7, 1] = float("nan")
    with pytest.raises(SDMError, match="1 of the points are not finite"):
        encode_scan(balls, broken)
    with pytest.raises(SDMError, match="normals; give one for each"):
        encode_scan(balls, some(200, 0.4), some(100, 1.0))
    for value in (float("nan"), float("inf"), 0.0):
        normals = some(200, 1.0)
        normals[[7, 9]] = value
        with pytest.raises(
            SDMError, match="2 normals of the scan are not finite or have no length, the first in row 7"
        ):
            encode_scan(balls, some(200, 0.4), normals)
    with pytest.raises(SDMError, match="0 steps were requested"):
        estimate_codes(balls, Scan(some(200, 0.4)), steps=0)
