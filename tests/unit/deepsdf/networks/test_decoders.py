"""The networks: the published one's size and values, and what ours starts from."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from sdm.deepsdf import Settings, local, published
from sdm.deepsdf.networks.auto_decoder import AutoDecoder, bounded, errors
from sdm.deepsdf.networks.decoders import make_decoder
from sdm.errors import SDMError
from sdm.losses import clamped_l1_loss


def test_the_published_network_has_the_published_number_of_parameters() -> None:
    assert sum(p.numel() for p in make_decoder(published()).parameters()) == 1_843_195


def test_the_published_network_is_that_of_code_and_point_joined() -> None:
    """The plain way: the code repeated for each point, joined to it at the first and the fifth layer."""
    settings = published(width=40, global_size=6)
    network = make_decoder(settings).eval()
    codes, points = torch.randn(3, 6), torch.rand(3, 11, 3) * 2 - 1
    entry = torch.cat([codes[:, None].expand(3, 11, 6), points], -1)
    x = entry
    for number, layer in enumerate(network.hidden):
        x = torch.relu(layer(torch.cat([x, entry], -1) if number == 4 else x))
    plain = torch.tanh(network.last(x))[..., 0]
    assert torch.allclose(network(codes, points), plain, atol=1e-6)


def test_dropout_is_there_in_training_alone() -> None:
    network = make_decoder(published(width=40, global_size=6))
    codes, points = torch.randn(1, 6), torch.rand(1, 50, 3)
    assert not torch.equal(network.train()(codes, points), network(codes, points))
    assert torch.equal(network.eval()(codes, points), network(codes, points))


def test_ours_starts_as_a_ball_whatever_the_code() -> None:
    settings = local()
    network = make_decoder(settings)
    points = torch.rand(2, 100, 3) * 2 - 1
    values = network(torch.randn(2, settings.code_size), points)
    assert torch.allclose(values, points.norm(dim=-1) - 0.5, atol=1e-6)


def test_a_local_code_changes_the_shape_near_its_node_alone() -> None:
    settings = local(global_size=4, grids=((3, 2),), width=16, layers=2)
    network = make_decoder(settings)
    nn.init.normal_(network.last.weight)
    points = torch.rand(1, 4000, 3) * 2 - 1
    code = torch.zeros(1, settings.code_size)
    other = code.clone()
    # The first node of the grid is at (-1,-1,-1), its cells end at 0.
    other[0, 4] = 1.0
    changed = network(code, points) != network(other, points)
    near = (points < 0).all(-1)
    assert changed[near].float().mean() > 0.99
    assert not changed[~near].any()


def test_weights_and_codes_are_functions_of_the_seed() -> None:
    torch.manual_seed(1)
    first = AutoDecoder(local(seed=3), 4).state_dict()
    torch.manual_seed(2)
    second, third = AutoDecoder(local(seed=3), 4).state_dict(), AutoDecoder(local(seed=4), 4).state_dict()
    assert all(torch.equal(first[k], second[k]) for k in first)
    assert not torch.equal(first["codes"], third["codes"])


@pytest.mark.parametrize("grids", [(), ((3, 2),)])
def test_all_that_is_trained_has_a_gradient(grids: tuple[tuple[int, int], ...]) -> None:
    """Several processes wait for the gradient of each parameter that wants one."""
    model = AutoDecoder(local(global_size=4, grids=grids, width=16, layers=2), 3)
    loss, length = model(torch.arange(3), torch.rand(3, 10, 3), torch.rand(3, 10))
    (loss + length).backward()
    wanting = {name for name, p in model.named_parameters() if p.requires_grad}
    assert wanting == {name for name, p in model.named_parameters() if p.grad is not None}
    assert ("decoder.of_grids.weight" in wanting) == bool(grids)


def test_the_published_loss_is_the_papers() -> None:
    prediction, values = torch.randn(2, 50) / 5, torch.randn(2, 50) / 5
    assert errors(prediction, values, published()).mean() == pytest.approx(
        float(clamped_l1_loss(prediction, values, delta=0.1)), rel=1e-6
    )


def test_ours_never_stops_pulling_at_a_wrong_prediction() -> None:
    prediction = torch.tensor([0.5], requires_grad=True)
    errors(prediction, torch.tensor([0.0]), local()).sum().backward()
    assert prediction.grad is not None
    assert prediction.grad.item() == 1.0


def test_codes_are_no_longer_than_their_bound() -> None:
    codes = torch.tensor([[3.0, 4.0], [0.3, 0.4]])
    assert torch.allclose(bounded(codes, 1.0), torch.tensor([[0.6, 0.8], [0.3, 0.4]]))
    assert torch.equal(bounded(codes, None), codes)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"variant": "other"}, "there is no variant called 'other'"),
        ({"schedule": "never"}, "there is no schedule called 'never'"),
        ({"points": 0}, "points is 0; it must be 1 or more"),
        ({"layers": 3}, "5 layers or more are needed"),
        ({"grids": ((1, 4),)}, "a resolution of at least 2"),
    ],
)
def test_settings_that_cannot_be_are_said(wrong: dict, said: str) -> None:
    with pytest.raises(SDMError, match=said):
        Settings(**wrong)
