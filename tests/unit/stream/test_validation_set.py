"""The fixed validation set: the same every time, named by what is in it, never part of any stream."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea, Family, Parameter
from sdm.stream import Mixture, SDMStream, Table, as_sampler
from sdm.stream.held_out import SHARE, is_held_out
from sdm.stream.held_out_samples import held_out_samples

FAMILY = Cochlea(600)


class Squeezed(Family):
    """A tetrahedron with one parameter, its height."""

    name = "squeezed"
    triangles = torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=torch.int32)

    def __init__(self, low: float = 1.0, high: float = 2.0) -> None:
        self.parameters = (Parameter("height", low, high),)

    def vertices(self, theta: torch.Tensor) -> torch.Tensor:
        corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        scale = torch.nn.functional.pad(theta, (2, 0), value=1.0)
        return corners * scale[:, None]


def stream(**options):
    return SDMStream(FAMILY, FAMILY.grid(10), 4, **{"device": "cpu", "seed": 3, **options})


def test_is_the_same_every_time_and_has_its_name():
    first, second = stream().validation(5), stream(sampler="sobol").validation(5)
    assert first.name == second.name
    assert torch.equal(first.sdm, second.sdm)
    assert first.name.startswith("val-")
    assert len(first.name) == 20


@pytest.mark.parametrize("options", [{"seed": 4}, {"dtype": torch.bfloat16}, {"truncate": 1.0}])
def test_other_content_has_another_name(options):
    names = {stream().validation(5).name, stream().validation(4).name, stream(**options).validation(5).name}
    assert len(names) == 3


def test_is_not_in_the_stream_and_leaves_it_alone():
    source = stream()
    held = source.validation(8)
    assert source.position == 0
    seen = torch.cat([source.sample(list(range(64))).theta, held.theta])
    assert len(set(map(tuple, seen.tolist()))) == 72


def test_reads_like_a_data_set():
    held = stream().validation(5)
    assert len(held) == 5
    assert [len(b.theta) for b in held.batches(2)] == [2, 2, 1]
    assert torch.equal(torch.cat([b.sdm for b in held.batches(2)]), held.sdm)
    assert held[3].sdm.shape == (1, 10, 10, 10)
    with pytest.raises(SDMError, match="at least 1"):
        stream().validation(0)


@pytest.mark.parametrize("name", ["uniform", "sobol", "chebyshev"])
def test_one_parameter_has_few_values_but_none_of_the_set_is_in_a_stream(name):
    family, numbers = Squeezed(), torch.arange(1 << 20)
    held = SDMStream(family, family.grid(4), 4, device="cpu").validation(64).theta
    for seed in (0, 1):
        given = as_sampler(name).theta(family, seed, numbers)
        assert not bool(is_held_out(given).any())
        assert not bool(torch.isin(held, given).any())


def test_all_places_of_the_box_are_left_out_alike():
    family, numbers = Squeezed(), torch.arange(1 << 20)
    held = SDMStream(family, family.grid(4), 4, device="cpu").validation(64).theta
    given = as_sampler("uniform").theta(family, 0, numbers)
    counts = torch.histc(given, 64, 1.0, 2.0)
    assert (counts / len(numbers) * 64 - 1).abs().max() < 0.05
    # What is left out would be among so many.
    assert bool(torch.isin(held, family.sample(1 << 20, sampler="uniform", device="cpu")).any())


def test_a_share_is_held_out_whatever_the_family():
    for family in (FAMILY, Squeezed(), Squeezed(1000.0, 1000.5)):
        share = is_held_out(family.sample(200_000, device="cpu")).double().mean()
        assert share == pytest.approx(1 / SHARE, rel=0.2)
    assert torch.equal(is_held_out(torch.tensor([[0.0, 1.0]])), is_held_out(torch.tensor([[-0.0, 1.0]])))


def test_what_a_table_gives_is_not_in_the_set():
    first = held_out_samples(FAMILY, 3, 5)
    for static in (Table(first[1:2]), Mixture(Table(first[1:2]))):
        assert torch.equal(held_out_samples(FAMILY, 2, 5, static), first[[0, 2]])
    grid = as_sampler("grid:3")
    points = FAMILY.grid_samples(3, device="cpu")
    assert bool(grid.includes(FAMILY, points).all())
    assert not bool(grid.includes(FAMILY, first).any())


def test_a_family_of_one_shape_streams_but_has_no_set():
    family = Squeezed(1.5, 1.5)
    source = SDMStream(family, family.grid(4), 4, device="cpu")
    assert torch.equal(source.sample([0, 1]).theta, torch.tensor([[1.5], [1.5]]))
    with pytest.raises(SDMError, match="squeezed has too few different shapes to hold 2 of them out for validation"):
        source.validation(2)
