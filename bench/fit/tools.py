"""Tools of the studies of the fit: simulated cases, backends by name, and cases in several processes."""

from __future__ import annotations

import functools
import itertools
import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import torch

from sdm.bench.fit.closest_maps import ClosestMaps
from sdm.bench.fit.stock_backend import StockBackend
from sdm.bench.fit.stock_closest import ClosestPointBackend
from sdm.bench.fit.stock_maps import StockMaps
from sdm.core.random import derive_seed
from sdm.fit import SCANNERS, ExactBackend, FitOptions, FitResult, Image, State, fit_shape, random_state, simulate
from sdm.fit.model.backend import Backend
from sdm.fit.model.backends import make_backends
from sdm.fit.model.exact import TRIANGLES
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, load_weights, measure
from sdm.surrogate.infer.predict import given_or_shipped
from sdm.surrogate.infer.weights_file import near_error

# Meshes of simulated truth have sixteen times as many triangles as those of the fit, four times its finest.
TRUTH_TRIANGLES = 320_000
# Shapes by which the error of a surrogate is measured that does not say it.
SHAPES = 16
STOCK = ("libigl", "warp", "libigl-map", "warp-map", "libigl-closest", "libigl-closest-map")


def truth_backend(device: str = "cpu") -> ExactBackend:
    """Exact distances from finer meshes than the fit's."""
    return ExactBackend(Cochlea(TRUTH_TRIANGLES), device)


def case(truth: ExactBackend, scanner: str, number: int, *, edge: float = 0.0) -> tuple[State, Image]:
    """A random shape and its image: a pure function of the scanner's name and the number."""
    state = random_state(truth, number, edge=edge)
    return state, simulate(truth, state, SCANNERS[scanner], seed=2 * number + (scanner == "0.2"))


def backends_by_name(name: str, device: str, weights: Path | None = None) -> tuple[Backend, Backend | None]:
    """Ours by `make_backends`, "surrogate-alone" without its anchors, or a stock library's."""
    if name in ("exact-map", "libigl-closest-map"):
        return ClosestMaps(name.split("-", maxsplit=1)[0]), None
    if name in STOCK:
        if name == "libigl-closest":
            return ClosestPointBackend(Cochlea(TRIANGLES), "cpu"), None
        library, *whole = name.split("-")
        return (StockMaps(library) if whole else StockBackend(library)), None
    if name == "surrogate-alone":
        model, facts = load_weights(given_or_shipped(weights), device)
        error = near_error(facts) or measured_error(model, device)
        return GridBackend(model, GRID, device=device, error=error), None
    return make_backends(name, weights=weights, device=device)


def measured_error(model: Callable[[torch.Tensor], torch.Tensor], device: str) -> float:
    """Root mean square error near the surface [mm] of a surrogate of the cochlea whose weights do not say."""
    theta = Cochlea().sample(SHAPES, seed=derive_seed(0, "error of a surrogate that does not say"), device="cpu")
    return near_error({"errors": measure(model, theta, device).summary()}) or 0.0


def fit_case(image: Image, scanner: str, backends: tuple[Backend, Backend | None]) -> FitResult:
    """Fit with the scanner's known blur and everything else as it comes."""
    options = FitOptions(blur=SCANNERS[scanner].blur)
    return fit_shape(image.values, image.grid, backends[0], finish=backends[1], options=options)


@functools.cache
def exact_backends(device: str) -> tuple[Any, Any]:
    """The backend that images are made by and the exact one that fits them, once for each process of a study."""
    torch.set_num_threads(1)
    return truth_backend(device), backends_by_name("exact", device)[0]


def run_cases(work: Callable[[Any], None], jobs: Sequence[Any], processes: int) -> None:
    """Do each job in order, in processes of one thread each where several are wanted."""
    if processes <= 1 or not jobs:
        for job in jobs:
            work(job)
        return
    # The first one here, so that the others find the kernels compiled.
    work(jobs[0])
    # Set before a process imports anything.
    os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "SDM_NUM_THREADS": "1"}
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for _ in pool.imap_unordered(work, jobs[1:]):
            pass


def counted(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Records of a study's cases, from the first one up to the first that is missing.

    Cases are drawn at random, in an order that is fixed. A study that is interrupted has its last cases in part: those
    that were quick. Counting them would favour quick cases; these are the same whatever each one took.
    """
    return [json.loads(path.read_text()) for path in itertools.takewhile(Path.is_file, paths)]
