"""Samplers: which parameters each number has."""

from __future__ import annotations

import math

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.stream import Mixture, SDMStream, Table, TensorGrid, as_sampler

FAMILY = Cochlea(600)
INDEX = torch.arange(1300)


def rows(theta: torch.Tensor) -> list[tuple[float, ...]]:
    return [tuple(row) for row in theta.tolist()]


@pytest.mark.parametrize("name", ["uniform", "sobol", "chebyshev", "grid:3", "grid:3:ordered", "mixture:0.25"])
def test_a_number_alone_is_the_same_as_in_a_batch(name):
    sampler = as_sampler(name)
    whole = sampler.theta(FAMILY, 7, INDEX)
    for number in (0, 1, 80, 81, 82, 1299):
        assert torch.equal(sampler.theta(FAMILY, 7, INDEX[number : number + 1])[0], whole[number])
    shuffled = INDEX.flip(0)
    assert torch.equal(sampler.theta(FAMILY, 7, shuffled), whole.flip(0))
    FAMILY.check(whole)
    if name != "grid:3:ordered":
        assert not torch.equal(sampler.theta(FAMILY, 8, INDEX), whole)


def test_chebyshev_has_the_arcsine_distribution():
    low, high = (torch.tensor([getattr(p, end) for p in FAMILY.parameters]) for end in ("low", "high"))
    unit = (as_sampler("chebyshev").theta(FAMILY, 3, torch.arange(20_000)) - low) / (high - low)
    for x in (0.01, 0.1, 0.5, 0.9, 0.99):
        share = 2 / math.pi * math.asin(math.sqrt(x))
        # Four deviations of a share of 20,000.
        assert (unit < x).double().mean(0).sub(share).abs().max() < 4 * math.sqrt(share * (1 - share) / 20_000)


def test_grid_is_the_papers_static_set_in_each_pass():
    expected = rows(FAMILY.grid_samples(5, device="cpu"))
    theta = TensorGrid(5).theta(FAMILY, 0, INDEX)
    first, second = rows(theta[:625]), rows(theta[625:1250])
    assert sorted(first) == sorted(second) == sorted(expected)
    assert first != second
    ordered = as_sampler("grid:5:ordered").theta(FAMILY, 0, INDEX)
    assert rows(ordered[:625]) == expected
    assert torch.equal(ordered[625:1250], ordered[:625])


def test_threads_share_a_sampler(monkeypatch):
    expected = TensorGrid(5).theta(FAMILY, 0, INDEX)
    # Another thread has always asked about another pass in between.
    other = property(lambda _: (None, torch.zeros(625, dtype=torch.int64)), lambda _, order: None)
    monkeypatch.setattr(TensorGrid, "_order", other, raising=False)
    assert torch.equal(TensorGrid(5).theta(FAMILY, 0, INDEX), expected)


def test_table_gives_its_own_rows():
    table = FAMILY.sample(7, seed=1, device="cpu")
    theta = Table(table).theta(FAMILY, 0, torch.arange(14))
    assert sorted(rows(theta[:7])) == sorted(rows(theta[7:])) == sorted(rows(table))
    assert str(Table(table)) != str(Table(table + 1))
    with pytest.raises(SDMError, match="N > 0"):
        Table(torch.zeros(0, 4))


def test_a_table_must_be_of_the_family():
    for row, message in (
        ([3.0, 0.3, 0.1], r"cochlea needs \(B, 4\)"),
        ([3.0, math.nan, 0.1, 0.0], r"alpha of theta\[1\] is nan"),
        ([30.0, 0.3, 0.1, 0.0], r"a of theta\[1\] is 30; cochlea takes 2 to 5 mm"),
    ):
        table = Table(torch.tensor([[3.0, 0.3, 0.1, 0.0][: len(row)], row]))
        for sampler in (table, Mixture(table)):
            with pytest.raises(SDMError, match=message):
                SDMStream(FAMILY, FAMILY.grid(4), 2, device="cpu", sampler=sampler)


@pytest.mark.parametrize("share", [0.5, 0.25, 0.9])
def test_mixture_has_its_share_everywhere(share):
    theta = Mixture("grid:3", "uniform", share).theta(FAMILY, 0, INDEX)
    static = set(rows(FAMILY.grid_samples(3, device="cpu")))
    hits = torch.tensor([row in static for row in rows(theta)]).int()
    for begin, end in ((0, 1300), (100, 200), (640, 700)):
        assert abs(int(hits[begin:end].sum()) - share * (end - begin)) <= 1
    # The static ones are passed through in whole, and online ones do not repeat.
    places = hits.nonzero().squeeze(1)[:81]
    if len(places) == 81:
        assert {rows(theta)[i] for i in places.tolist()} == static
    online = [row for row, hit in zip(rows(theta), hits.tolist(), strict=True) if not hit]
    assert len(set(online)) == len(online)


def test_names_say_which_sampler_it_is():
    for name in ("uniform", "sobol", "chebyshev", "grid:3", "grid:3:ordered", "mixture:0.3"):
        sampler = as_sampler(name)
        again = as_sampler(str(sampler))
        assert torch.equal(again.theta(FAMILY, 1, INDEX), sampler.theta(FAMILY, 1, INDEX))


def test_bad_names_are_refused():
    for name in ("", "grid:x", "grid:1", "grid:5:5", "uniform:2", "mixture:0", "mixture:1.5", "mixture:nan"):
        with pytest.raises(SDMError):
            as_sampler(name)
