"""Training of a low-rank surrogate of any family within a time, on maps that the exact engine makes for it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

from sdm.core.grid import Grid
from sdm.core.random import derive_seed, generator
from sdm.engine.many import signed_distance_maps
from sdm.errors import SDMError
from sdm.shapes import Family
from sdm.surrogate.families.low_rank import MOST_PARAMETERS, MOST_TERMS, LowRankSurrogate, count_of_terms
from sdm.surrogate.networks.pod_chebyshev import decompose
from sdm.training.random_numbers import own_random_numbers
from sdm.training.schedules import warmup_cosine

# Shares of the time: maps first; the network takes what the decomposition leaves.
MAKING = 0.55
BATCH, ROWS = 16, 256
# One of so many maps is not fitted to, so that degree and network are chosen by what they do to fresh shapes.
HELD = 10
MOST_MAPS, MOST_SNAPSHOTS, MOST_MODES = 20_000, 2048, 256
# Bytes of all maps that are kept, as float16.
MOST_BYTES = 4 << 30
RIDGE, RATE = 1e-8, 2e-3
# Modes hold all but this share of the maps' variance.
LEFT = 1e-7
RESOLUTION = 48


def train_family(
    family: Family,
    grid: Grid | None = None,
    *,
    budget_s: float = 60.0,
    modes: int | None = None,
    hidden: int = 128,
    seed: int = 0,
    device: torch.device | str = "cpu",
    report: Callable[[str], None] = print,
) -> tuple[LowRankSurrogate, Grid]:
    """A surrogate of a family, on its own grid.

    Args:
        family: 1 to 64 parameters, fixed faces.
        grid: Where it answers; by default a cube of 48^3 voxels that holds every shape.
        budget_s: Seconds for all of it.
        modes: How many; by default as many as hold all but 1e-7 of the variance, 256 at most.
        hidden: Width of the network; 0 for polynomials alone.
        seed: Of shapes and network.
        device: Where to work.
        report: Is told in one line what has been done.

    Returns:
        The surrogate, on the host, and its grid.

    Raises:
        SDMError: Too many parameters, a family whose faces differ, or too little time for any map.
    """
    count = len(family.parameters)
    if not 1 <= count <= MOST_PARAMETERS:
        raise SDMError(f"{family.name} has {count} parameters; surrogates take 1 to {MOST_PARAMETERS}")
    if family.places_meshes:
        raise SDMError(f"{family.name} has shapes with faces of their own, which have no surrogate")
    if not 0 < budget_s < math.inf:
        raise SDMError(f"the budget is {budget_s} s; give a positive number of seconds")
    begin = time.perf_counter()
    grid = family.grid(RESOLUTION) if grid is None else grid
    where = torch.device(device)
    theta, maps = _make(family, grid, MAKING * budget_s, seed, where)
    held = torch.arange(len(theta), device=where) % HELD == HELD - 1
    report(f"{len(theta):,} maps of {' x '.join(map(str, grid.shape))} in {time.perf_counter() - begin:.1f} s")
    fitted = maps[~held]
    most = min(len(fitted) - 1, MOST_SNAPSHOTS - 1, MOST_MODES if modes is None else modes)
    mean, basis, deviations = decompose(fitted[:MOST_SNAPSHOTS].flatten(1), most)
    if modes is None:
        energy = deviations.double().square()
        share = 1 - energy.cumsum(0) / energy.sum().clamp_min(1e-30)
        kept = int((share > LEFT).sum()) + 1
        basis = basis[:kept].contiguous()
    wanted = torch.cat([(part.flatten(1).float() - mean) @ basis.T for part in maps.split(ROWS)])
    low, high = [p.low for p in family.parameters], [p.high for p in family.parameters]
    model, degree = _polynomials(low, high, grid, theta, wanted, held, hidden, seed)
    model = model.to(where)
    model.mean, model.modes = mean, basis
    left = budget_s - (time.perf_counter() - begin)
    report(f"{len(basis)} modes, polynomials of degree {degree}: {_error(model, theta, wanted, held):.3g} left")
    if model.network is not None and left > 0.5:
        _network(model, theta, wanted, held, left, seed)
        report(f"with the network: {_error(model, theta, wanted, held):.3g} left, {time.perf_counter() - begin:.1f} s")
    elif hidden:
        model.scale.zero_()
    return model.cpu().eval().requires_grad_(False), grid


def exact_maps(family: Family, theta: Tensor, grid: Grid, device: torch.device) -> Tensor:
    """Exact maps (B,nx,ny,nz) of theta (B,P)."""
    with torch.no_grad():
        theta = theta.to(device)
        return signed_distance_maps(family.vertices(theta), family.faces_on(device), grid, device=device)


def _make(family: Family, grid: Grid, seconds: float, seed: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Parameters (N,P) and maps (N,nx,ny,nz) float16 of as many shapes as the time allows."""
    own = derive_seed(seed, "surrogate of a family")
    most = max(HELD * 2, min(MOST_MAPS, MOST_BYTES // (2 * grid.size)))
    theta, maps, made = [], [], 0
    begin = time.perf_counter()
    # The first call compiles, which must not eat the time of a small budget.
    while made < HELD * 2 or (made < most and time.perf_counter() - begin < seconds):
        number = torch.arange(made, made + BATCH, dtype=torch.int64, device="cpu")
        # Half of them denser towards the ends of the parameters, where polynomials and networks are worst.
        even = family.sample_at(number[::2], seed=own, sampler="sobol")
        edge = family.sample_at(number[1::2], seed=own, sampler="chebyshev")
        both = torch.cat([even, edge]).to(device)
        theta.append(both)
        maps.append(exact_maps(family, both, grid, device).half())
        made += BATCH
        if device.type == "cuda":
            torch.cuda.synchronize(device)
    return torch.cat(theta), torch.cat(maps)


def _polynomials(
    low: list[float],
    high: list[float],
    grid: Grid,
    theta: Tensor,
    wanted: Tensor,
    held: Tensor,
    hidden: int,
    seed: int,
) -> tuple[LowRankSurrogate, int]:
    """The model whose polynomials are best on the held shapes, and their degree."""
    best: tuple[float, LowRankSurrogate, int] | None = None
    for degree in range(16):
        terms = count_of_terms(len(low), degree)
        if degree > 1 and (terms > MOST_TERMS or terms > 0.5 * int((~held).sum())):
            break
        with own_random_numbers():
            torch.manual_seed(derive_seed(seed, "surrogate of a family, network"))
            model = LowRankSurrogate(low, high, grid.shape, wanted.shape[1], degree, hidden).to(theta.device)
        table = model.terms(theta).double()
        normal = table[~held].T @ table[~held]
        normal.diagonal().add_(RIDGE * normal.diagonal().mean())
        model.weights = torch.linalg.solve(normal, table[~held].T @ wanted[~held].double()).float()
        error = float((table[held].float() @ model.weights - wanted[held]).square().sum(1).mean())
        if best is None or error < best[0]:
            best = error, model, degree
    assert best is not None  # noqa: S101 - degree 0 is always there
    _, model, degree = best
    model.scale = (wanted - model.terms(theta) @ model.weights)[~held].std(0).clamp_min(1e-12)
    last = model.network[-1] if isinstance(model.network, nn.Sequential) else None
    if isinstance(last, nn.Linear):
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
    return model, degree


def _network(model: LowRankSurrogate, theta: Tensor, wanted: Tensor, held: Tensor, seconds: float, seed: int) -> None:
    """Train the network for what polynomials leave; it stays only as good as it is on held shapes."""
    network = model.network
    assert network is not None  # noqa: S101 - for the type checker
    fit_theta, rest = theta[~held], (wanted - model.terms(theta) @ model.weights)[~held]
    begun, steps = time.perf_counter(), 0
    best, state = _error(model, theta, wanted, held), {k: v.clone() for k, v in network.state_dict().items()}
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-4)
    random = generator(seed, "surrogate of a family, batches", device=theta.device)
    while (share := (time.perf_counter() - begun) / seconds) < 1:
        for group in optimizer.param_groups:
            group["lr"] = RATE * warmup_cosine(share)
        rows = torch.randint(len(fit_theta), (ROWS,), generator=random, device=theta.device)
        # Modes are orthonormal: this is the squared error of the maps.
        loss = (model.rest(fit_theta[rows]) * model.scale - rest[rows]).square().sum(1).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        steps += 1
        if steps % 200 == 0:
            error = _error(model, theta, wanted, held)
            if error < best:
                best, state = error, {k: v.clone() for k, v in network.state_dict().items()}
    if _error(model, theta, wanted, held) > best:
        network.load_state_dict(state)


@torch.no_grad()
def _error(model: LowRankSurrogate, theta: Tensor, wanted: Tensor, held: Tensor) -> float:
    """Root mean square error of a voxel on the held shapes, of what the modes can show."""
    error = (model.coefficients(theta[held]) - wanted[held]).square().sum(1).mean()
    return math.sqrt(float(error) / model.mean.numel())
