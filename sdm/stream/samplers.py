"""Samplers: the parameters of each sample, a pure function of (seed, global number), drawn on the host.

A batch's parameters are a few kilobytes; drawn on the host, they are the same bits whatever the device, and a family
whose samples differ in mesh knows without asking a GPU which mesh each sample needs.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from fractions import Fraction
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from sdm.core.given_values import real, whole
from sdm.core.mesh import as_tensor
from sdm.core.random import derive_seed
from sdm.errors import SDMError
from sdm.shapes import Family, sampling
from sdm.stream.held_out import held_out_rows, is_held_out

# Shares of a mixture are fractions with at most this denominator.
FINEST_SHARE = 10_000
# Draws for a sample until one is not held out. Only a family of very few different shapes needs more than three.
MOST_ATTEMPTS = 16


class Sampler(ABC):
    """Parameters by number. A subclass says `theta`, and in `__str__` all that it depends on."""

    @abstractmethod
    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """Parameters (B,P) float32 on the host for global numbers `index` (B,) int64 on the host."""

    @abstractmethod
    def __str__(self) -> str: ...

    def size(self, family: Family) -> int | None:
        """Number of samples after which they come again; None for never.

        Raises:
            MeshError: The sampler has no parameters for this family.
        """
        return None

    def includes(self, family: Family, theta: Tensor) -> Tensor:
        """True (B,) for the rows of theta (B,P), on the host, that some sample may be equal to.

        A subclass that gives held-out rows (`sdm.stream.held_out`) has to say so here.
        """
        return ~is_held_out(theta)


class _Random(Sampler):
    """Samples of the family by the sampler `name` of `Family.sample_at`, others instead of those that are held out."""

    name: ClassVar[str]

    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """As `Sampler.theta`."""
        theta = family.sample_at(index, seed=seed, sampler=self.name)
        values = theta.numpy()
        rows = np.flatnonzero(held_out_rows(values))
        # Batches of 64 meet this in two of five times: only the rows that are drawn again are looked at again.
        for attempt in range(MOST_ATTEMPTS):
            if not len(rows):
                break
            own = derive_seed(seed, "instead of held-out samples", attempt)
            again = family.sample_at(index[torch.from_numpy(rows)], seed=own, sampler=self.name).numpy()
            values[rows] = again
            rows = rows[held_out_rows(again)]
        return theta

    def __str__(self) -> str:
        return self.name


class Uniform(_Random):
    """Independent and uniform over the family's box: the paper's online samples."""

    name = "uniform"


class Sobol(_Random):
    """Evenly spread over the family's box, by a randomly shifted Sobol sequence."""

    name = "sobol"


class Chebyshev(_Random):
    """Independent, denser towards faces and corners of the family's box: see `sdm.shapes.sampling.chebyshev`."""

    name = "chebyshev"


class _Static(Sampler):
    """A finite set, passed through again and again; each pass in an order of its own unless `shuffle` is off."""

    def __init__(self, shuffle: bool) -> None:
        self.shuffle = shuffle
        self._order: tuple[tuple[int, int], Tensor] | None = None

    def _places(self, family: Family, count: int, seed: int, index: Tensor) -> Tensor:
        """The member (B,) int64 of the set that each sample is."""
        passes, places = index // count, index % count
        if not self.shuffle:
            return places
        found = torch.empty_like(places)
        for number in passes.unique().tolist():
            mine = passes == number
            own = derive_seed(seed, "order of a static set", family.name, number)
            found[mine] = self._permutation(count, own)[places[mine]]
        return found

    def _permutation(self, count: int, seed: int) -> Tensor:
        key = (count, seed)
        # Samples come in order, so one pass is asked about many times in a row.
        known = self._order
        if known is None or known[0] != key:
            numbers = torch.arange(count, device="cpu")
            draws = sampling.uniform(seed, numbers, 2).double()
            # Another thread may ask about another pass at any moment: what is kept is not read again.
            self._order = known = (key, torch.argsort(draws[:, 0] + draws[:, 1] * 2.0**-24, stable=True))
        return known[1]


class TensorGrid(_Static):
    """The tensor grid over the family's box, its faces included: for 5 and 4 parameters the paper's 625 static shapes.

    Args:
        per_axis: Points along each axis, at least 2.
        shuffle: Whether each pass over the grid has an order of its own, a function of the seed.
    """

    def __init__(self, per_axis: int = 5, *, shuffle: bool = True) -> None:
        count = whole(per_axis, 2)
        if count is None:
            raise SDMError(f"a grid of {per_axis!r} points for each axis has no width; give 2 or more")
        super().__init__(shuffle)
        self.per_axis = count

    def size(self, family: Family) -> int:
        """Number of points of the grid."""
        count = self.per_axis ** len(family.parameters)
        if count > sampling.LARGEST_GRID:
            raise SDMError(
                f"a grid of {self.per_axis} points for each of {len(family.parameters)} parameters is too large: "
                "use a random sampler"
            )
        return count

    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """As `Sampler.theta`."""
        place = self._places(family, self.size(family), seed, index)
        axis = torch.linspace(0, 1, self.per_axis, dtype=torch.float32, device="cpu")
        digits = [place // self.per_axis**k % self.per_axis for k in reversed(range(len(family.parameters)))]
        return family.from_unit(torch.stack([axis[d] for d in digits], 1))

    def includes(self, family: Family, theta: Tensor) -> Tensor:
        """As `Sampler.includes`."""
        axis = torch.linspace(0, 1, self.per_axis, dtype=torch.float32, device="cpu")
        values = family.from_unit(axis[:, None].expand(-1, len(family.parameters)).contiguous())
        return (theta[:, None] == values).any(1).all(1)

    def __str__(self) -> str:
        return f"grid:{self.per_axis}" + ("" if self.shuffle else ":ordered")


class Table(_Static):
    """A set of shapes of your own.

    Args:
        theta: (N,P) parameters in the family's box.
        shuffle: Whether each pass over the table has an order of its own, a function of the seed.
    """

    def __init__(self, theta: Tensor, *, shuffle: bool = True) -> None:
        super().__init__(shuffle)
        self.rows = as_tensor(theta, torch.float32, "the rows of a table", device=torch.device("cpu")).detach()
        if self.rows.ndim != 2 or self.rows.shape[0] == 0:
            raise SDMError(f"the table has shape {tuple(self.rows.shape)}; (N, P) with N > 0 is needed")

    def size(self, family: Family) -> int:
        """Number of rows, each of which must be in the family's box."""
        family.check(self.rows)
        return self.rows.shape[0]

    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """As `Sampler.theta`."""
        return self.rows[self._places(family, self.rows.shape[0], seed, index)]

    def includes(self, family: Family, theta: Tensor) -> Tensor:
        """As `Sampler.includes`."""
        known = set(map(tuple, self.rows.tolist()))
        return torch.tensor([tuple(row) in known for row in theta.tolist()], dtype=torch.bool, device="cpu")

    def __str__(self) -> str:
        digest = hashlib.sha256(self.rows.numpy().tobytes()).hexdigest()[:16]
        return f"table:{digest}" + ("" if self.shuffle else ":ordered")


class Mixture(Sampler):
    """A static set mixed evenly with online samples, as in Wang et al., MIDL 2020.

    Args:
        static: The set, for example `TensorGrid(5)`.
        online: Where the others come from.
        share: Share of the static samples, above 0 and below 1. They are spread evenly: of the first n samples
            floor(n share) are static.
    """

    def __init__(self, static: Sampler | str = "grid:5", online: Sampler | str = "uniform", share: float = 0.5) -> None:
        self.static, self.online = as_sampler(static), as_sampler(online)
        if not 0 < real(share) < 1:
            raise SDMError(f"the share of static samples is {share!r}; give a number between 0 and 1")
        self.share = Fraction(share).limit_denominator(FINEST_SHARE)
        if not 0 < self.share < 1:
            raise SDMError(f"the share of static samples is {share}; the least is {1 / FINEST_SHARE:g}")

    def size(self, family: Family) -> int | None:
        """Never the same again: online samples are among them."""
        for part in (self.static, self.online):
            part.size(family)
        return None

    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """As `Sampler.theta`."""
        up, down = self.share.numerator, self.share.denominator
        before = index // down * up + index % down * up // down
        is_static = (index % down + 1) * up // down > index % down * up // down
        theta = torch.empty(index.shape[0], len(family.parameters), dtype=torch.float32, device="cpu")
        for sampler, name, rows, number in (
            (self.static, "static", is_static, before),
            (self.online, "online", ~is_static, index - before),
        ):
            if bool(rows.any()):
                theta[rows] = sampler.theta(family, derive_seed(seed, "part of a mixture", name), number[rows])
        return theta

    def includes(self, family: Family, theta: Tensor) -> Tensor:
        """As `Sampler.includes`."""
        return self.static.includes(family, theta) | self.online.includes(family, theta)

    def __str__(self) -> str:
        if (str(self.static), str(self.online)) == ("grid:5", "uniform"):
            return f"mixture:{self.share}"
        return f"mixture({self.static}, {self.online}, {self.share})"


RANDOM: dict[str, type[Sampler]] = {"uniform": Uniform, "sobol": Sobol, "chebyshev": Chebyshev}


def as_sampler(sampler: Sampler | str) -> Sampler:
    """A sampler, or one by name: "uniform", "sobol", "chebyshev", "grid:5", "mixture:0.25", ...

    Raises:
        SDMError: There is no sampler of that name.
    """
    if isinstance(sampler, Sampler):
        return sampler
    kind, *words = str(sampler).split(":")
    try:
        if kind in RANDOM and not words:
            return RANDOM[kind]()
        if kind == "grid" and words[1:] in ([], ["ordered"]):
            return TensorGrid(int(words[0]) if words else 5, shuffle=len(words) < 2)
        if kind == "mixture" and len(words) < 2:
            return Mixture(share=float(Fraction(words[0])) if words else 0.5)
    except SDMError:
        raise
    except (ValueError, ZeroDivisionError, OverflowError):
        pass
    raise SDMError(
        f"there is no sampler called {sampler!r}; use uniform, sobol, chebyshev, grid:N, "
        "grid:N:ordered or mixture:SHARE"
    )
