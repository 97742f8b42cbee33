"""Error against time of one map of a cochlea: networks, a decomposition, our exact engine and libigl, in one run.

    python -m sdm.bench.surrogate.error_time [--pod 2048] [--maps FILE.pt] [--degree 8] [--rounds 9]

Meshes of fewer triangles are quicker, and further from the mesh of 20,000 that all are compared with; a decomposition
(POD with Chebyshev polynomials) is quicker with fewer modes; the shipped network has one point for each runtime that is
installed. libigl is timed on the coarsest mesh too whose error is no larger than the network's: the record says how
many times as quick the network is, by torch, as libigl on the reference mesh and there. All methods take turns, shape
by shape and round by round, on one core, and times are medians of processor time, so that a machine that does other
work tells nearly the same as an idle one. Errors are means over all voxels, and over those within 0.5 mm of the
surface, of some shapes that no training has seen. Results: bench/results/surrogate-error-time.json and
docs/surrogate-error-time.png.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.checkout import docs_folder, results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.markdown import markdown_table
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer
from sdm.bench.peers.libigl import LibiglPseudonormal, LibiglWinding
from sdm.bench.surrogate.error_time_figure import draw
from sdm.core.device import choose_device
from sdm.engine.many import signed_distance_maps
from sdm.io.files.torch_file import save_torch
from sdm.shapes import Cochlea
from sdm.stream import SDMStream
from sdm.surrogate import GRID, PODChebyshev, load_weights, shipped_weights
from sdm.surrogate.infer.runtime import available, runner
from sdm.surrogate.train.map_buffer import Replay
from sdm.surrogate.train.validation import validation_theta

TRIANGLES = (500, 1250, 3000, 7000, 20_000)
REFERENCE = TRIANGLES[-1]
# Steps by which meshes grow until one has no larger error than the network.
FINER = 250
MODES = (16, 32, 64, 128, 256)
NEAR_MM = 0.5
# What a row has of errors: means over the voxels within NEAR_MM of the surface, and over all.
ERRORS = ("mae_near_mm", "mae_mm")
# The first 16 of the validation set are the corners of the box.
CORNERS = 16
POD_SEED = 77
# Quicker calls than this are timed as a fit has them, after another of the same method.
QUICK_S = 0.1
PACKAGES = ("warp-lang", "torch", "numpy", "libigl", "onnxruntime", "openvino")

Method = Callable[[Tensor], Tensor]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pod", type=int, default=2048, help="maps that the decomposition is fitted to; 0: none")
    parser.add_argument("--maps", type=Path, default=None, help="file that keeps these maps for the next time")
    parser.add_argument("--weights", type=Path, default=None, help="of SDMNN+; by default the shipped ones")
    parser.add_argument("--shapes", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--degree", type=int, default=8, help="of the decomposition's polynomials")
    parser.add_argument("--out", type=Path, default=results_folder() / "surrogate-error-time.json")
    parser.add_argument("--picture", type=Path, default=docs_folder() / "surrogate-error-time.png")
    options = parser.parse_args()
    # Threads that wait for each other would count as work.
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    theta = validation_theta(Cochlea(), CORNERS + options.shapes)[CORNERS:]
    found = networks(options.weights)
    equal = coarsest(found["SDMNN+", "torch"], theta)
    if options.pod:
        found |= decompositions(options)
    found |= by_meshes(sorted({*TRIANGLES, *equal.values()}))
    rows = measured(found, theta, options.rounds)
    record = {
        "machine": describe("cpu", PACKAGES),
        "clock": "processor time of one core",
        "shapes": len(theta),
        "rounds": options.rounds,
        "pod_maps": options.pod,
        "pod_degree": options.degree,
        "times_libigl_by_torch": times_libigl(rows, equal),
        "rows": rows,
    }
    write(options.out, record)
    draw(record, options.picture)
    cells = [[r["method"], r["of"], f"{r['ms']:.2f}", f"{r['mae_near_mm']:.5f}", f"{r['mae_mm']:.5f}"] for r in rows]
    for error, at in record["times_libigl_by_torch"].items():
        print(f"libigl on {at['triangles']:,} triangles ({error}) takes {at['times']} times as long as SDMNN+ by torch")
    print(markdown_table(["method", "of", "ms", "error near the surface [mm]", "everywhere [mm]"], cells))


def networks(weights: Path | None) -> dict[tuple[str, str], Method]:
    """SDMNN+ by each runtime that is installed."""
    file = weights or shipped_weights()
    if file is None:
        raise SystemExit("there are no shipped weights here: name some by --weights")
    model = load_weights(file)[0].eval()
    return {("SDMNN+", backend): runner(model, backend, 1) for backend in available()}


def decompositions(options: argparse.Namespace) -> dict[tuple[str, str], Method]:
    """One POD by its first modes."""
    whole = decomposition(options.pod, options.degree, options.maps)
    return {("POD + Chebyshev", f"{modes} modes"): quiet(first_modes(whole, modes)) for modes in MODES}


def by_meshes(counts: Iterable[int]) -> dict[tuple[str, str], Method]:
    """The exact engine and libigl on meshes of so many triangles."""
    found: dict[tuple[str, str], Method] = {}
    for triangles in counts:
        family = Cochlea(triangles)
        found["exact engine", named(triangles)] = exact(family)
        if importlib.util.find_spec("igl") is not None:
            for peer in (LibiglWinding(), LibiglPseudonormal()):
                found[peer.name, named(triangles)] = by_peer(peer, family)
    return found


def named(triangles: int) -> str:
    return f"{triangles:,} triangles"


def coarsest(network: Method, theta: Tensor) -> dict[str, int]:
    """Triangles of the coarsest meshes whose maps are no further from the reference's than the network's.

    Two counts, by the error of a row that is compared.
    """
    wanted = truth(theta)
    limits, found = errors_of(network, theta, wanted), {}
    for triangles in range(TRIANGLES[0], REFERENCE + 1, FINER):
        own = errors_of(exact(Cochlea(triangles)), theta, wanted)
        for error, limit, mean in zip(ERRORS, limits, own, strict=True):
            if mean <= limit:
                found.setdefault(error, triangles)
        if len(found) == len(ERRORS):
            break
    return found


def truth(theta: Tensor) -> list[Tensor]:
    method = exact(Cochlea())
    return [method(row[None]) for row in theta]


def errors_of(method: Method, theta: Tensor, wanted: list[Tensor]) -> tuple[float, float]:
    """Means over shapes of the mean error near the surface and everywhere [mm]."""
    near, all_ = zip(
        *(_errors(method(row[None]), right) for row, right in zip(theta, wanted, strict=True)), strict=True
    )
    return statistics.fmean(near), statistics.fmean(all_)


def _errors(values: Tensor, right: Tensor) -> tuple[float, float]:
    error = (values - right).abs()
    return float(error[right.abs() < NEAR_MM].mean()), float(error.mean())


def times_libigl(rows: list[dict[str, Any]], equal: dict[str, int]) -> dict[str, Any]:
    """libigl's time, by the quicker of its signs, over that of SDMNN+ by plain torch.

    On the reference mesh, whose maps are the truth here, and on the coarsest meshes that are no worse than the network
    by each of the two errors.
    """
    ours = next(row["ms"] for row in rows if (row["method"], row["of"]) == ("SDMNN+", "torch"))
    found = {}
    for name, triangles in {"reference": REFERENCE, **equal}.items():
        own = [row["ms"] for row in rows if row["method"].startswith("libigl") and row["of"] == named(triangles)]
        if own:
            found[name] = {"triangles": triangles, "times": round(min(own) / ours, 1)}
    return found


def measured(found: dict[tuple[str, str], Method], theta: Tensor, rounds: int) -> list[dict[str, Any]]:
    """A row for each method; its first call is not timed, nor those by which quick ones have their caches filled."""
    wanted = truth(theta)
    times: dict[tuple[str, str], list[float]] = {key: [] for key in found}
    errors: dict[tuple[str, str], list[tuple[float, float]]] = {key: [] for key in found}
    quick: dict[tuple[str, str], bool] = {}
    for key, method in found.items():
        for row, right in zip(theta, wanted, strict=True):
            start = time.process_time()
            values = method(row[None])
            quick[key] = time.process_time() - start < QUICK_S
            errors[key].append(_errors(values, right))
    for turn in range(rounds):
        for row in theta:
            for key, method in found.items():
                if quick[key]:
                    method(row[None])
                start = time.process_time()
                method(row[None])
                times[key].append(1000 * (time.process_time() - start))
        print(f"round {turn + 1} of {rounds}", flush=True)
    return [
        {
            "method": key[0],
            "of": key[1],
            "ms": round(statistics.median(times[key]), 3),
            "least_ms": round(min(times[key]), 3),
            **dict(zip(ERRORS, map(statistics.fmean, zip(*errors[key], strict=True)), strict=True)),
        }
        for key in found
    ]


def exact(family: Cochlea) -> Method:
    def run(theta: Tensor) -> Tensor:
        with torch.no_grad():
            faces = family.faces_on(theta.device)
            return signed_distance_maps(family.vertices(theta), faces, GRID, device="cpu")[:, None]

    return run


def by_peer(peer: Peer, family: Cochlea) -> Method:
    points = GRID.points().reshape(-1, 3).contiguous()

    def run(theta: Tensor) -> Tensor:
        with torch.no_grad():
            vertices = family.vertices(theta)[0].numpy()
        peer.build(Case("cochlea", vertices, family.faces.numpy(), frozenset({"closed"})))
        return peer.signed_distance(points).reshape(1, 1, *GRID.shape).float()

    return run


def quiet(model: torch.nn.Module) -> Method:
    def run(theta: Tensor) -> Tensor:
        with torch.inference_mode():
            return model(theta)

    return run


def decomposition(maps: int, degree: int, file: Path | None) -> PODChebyshev:
    """Fitted to so many maps of the training's kind, which the file keeps."""
    if file is None or not file.is_file():
        stream = SDMStream(Cochlea(), GRID, 8, POD_SEED, 0, 1, sampler="chebyshev", device=choose_device(None))
        replay = Replay(stream, maps)
        replay.fill()
        kept = {"theta": replay.theta.cpu(), "maps": replay.maps.cpu()}
        if file is not None:
            save_torch(kept, file)
    else:
        kept = torch.load(file, weights_only=True)
    model = PODChebyshev(min(MODES[-1], maps - 1), degree)
    return model.fit(kept["theta"][:maps], kept["maps"][:maps]).eval()


def first_modes(model: PODChebyshev, modes: int) -> PODChebyshev:
    """The same with fewer modes: they are orthonormal, so the others stay as they are."""
    own = PODChebyshev(1, model.config["degree"])
    own.mean, own.modes = model.mean, model.modes[:modes].contiguous()
    own.weights = model.weights[:, :modes].contiguous()
    return own.eval()


if __name__ == "__main__":
    main()
