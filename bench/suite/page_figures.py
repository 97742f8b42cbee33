"""Figures of public pages beside the records that they come from: `python -m sdm.bench.suite.page_figures`.

Each figure is a phrase of a page with places for numbers, which are filled from a record of `bench/results/`. A phrase
that the page does not hold is out of step with its record: one of the two has changed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import exp, log
from typing import Any

from sdm.bench.common.checkout import checkout, results_folder
from sdm.bench.suite import disk_figures
from sdm.bench.suite.band_figures import (
    beside_meshlib,
    beside_others,
    means_on_a_gpu,
    milliseconds_on_a_gpu,
    shares_of_openvdb,
    surface_milliseconds,
    voxels_off_edges,
    watertight_seconds,
)
from sdm.bench.suite.fit_figures import FIT_FIGURES
from sdm.bench.suite.other_tools_figures import OTHER_TOOLS_FIGURES
from sdm.bench.suite.page_tables import TABLES
from sdm.bench.suite.readme_figures import README_FIGURES
from sdm.bench.suite.shape_figures import SHAPE_FIGURES

README, GUIDE, SPEED, PAPERS = "README.md", "docs/guide.md", "docs/speed.md", "docs/papers.md"
STREAM, SURROGATE, FIT = "sdm/stream/README.md", "sdm/surrogate/README.md", "sdm/fit/README.md"
DEEPSDF, LARGE = "sdm/deepsdf/README.md", "docs/howto/large.md"
WANG = "docs/papers/wang.md"
SCIPY, DISK = "docs/from/scipy.md", "docs/from-disk-to-disk.md"

Numbers = Callable[[Any], Sequence[Any]]


@dataclass(frozen=True)
class Figure:
    """A phrase with numbers.

    Args:
        page: From the root of the checkout.
        words: As the page has it, with a place of `str.format` for each number.
        record: Name in `bench/results/`, without `.json`.
        numbers: Takes the record.
    """

    page: str
    words: str
    record: str
    numbers: Numbers

    def phrase(self) -> str:
        """The words with the record's numbers."""
        return self.words.format(*self.numbers(record(self.record)))


@cache
def record(name: str) -> Any:
    """A record's content."""
    return json.loads((results_folder() / f"{name}.json").read_text())


@cache
def text(page: str) -> str:
    """A page with single blanks for all white space."""
    root = checkout()
    assert root is not None
    return " ".join((root / page).read_text().split())


def geometric_mean(numbers: Sequence[float]) -> float:
    """Of positive numbers."""
    return exp(sum(map(log, numbers)) / len(numbers))


def _means(record: Any, peer: str = "fastest peer") -> list[float]:
    means = record["parts"]["table"]["summary"]["geometric_means"]
    return [means[n][peer] for n in ("128", "256", "512")]


def _shares(record: Any) -> list[float]:
    """Per cent of a grid of 512^3 on which peers by winding numbers are timed."""
    rows = [row["peers"] for row in record["parts"]["table"]["rows"] if row["resolution"] == 512]
    return _range([100 * peer["share"] for peers in rows for peer in peers if "winding" in peer["peer"]])


def _scratch(record: Any) -> list[float]:
    """Memory of maps of meshes of up to 100,000 triangles, less the maps, in MiB to tens."""
    rows = [row for row in record["parts"]["table"]["rows"] if row["triangles"] <= 100_000]
    return [round(x, -1) for x in _range([row["peak_mib"] - row["map_mib"] for row in rows])]


def _batches(record: Any) -> list[float]:
    """Maps a second of 64 in one call, repeated and without a recording."""
    row = record["parts"]["graph"]["rows"][-1]
    return [round(x, -1) for x in (row["sdms_per_second"], 1000 * row["batch"] / row["plain"]["ms"])]


def _means_on_a_cpu(record: Any) -> list[float]:
    return [record["parts"]["table"]["summary"]["geometric_means"]["128"]["fastest peer"]]


def _points(record: Any) -> list[float]:
    means = record["parts"]["points"]["summary"]["geometric_means"]
    return [means["uniform"], means["near"]]


def _first(record: Any) -> list[float]:
    """First calls at 256^3 and 512^3: how many times as fast as the fastest peer, which is warm."""
    rows = record["parts"]["table"]["rows"]
    return [
        geometric_mean([min(p["ms"] for p in r["peers"]) / r["first_ms"] for r in rows if r["resolution"] == n])
        for n in (256, 512)
    ]


def _range(numbers: Sequence[float]) -> list[float]:
    return [min(numbers), max(numbers)]


def _times(record: Any, name: str) -> list[float]:
    return _range([r["first_ms"] if name == "first" else r[name]["ms"] for r in _rows(record, 256)])


def _rows(record: Any, resolution: int) -> list[Any]:
    return [row for row in record["parts"]["table"]["rows"] if row["resolution"] == resolution]


def _five_million(record: Any) -> list[float]:
    last = record["parts"]["triangles"]["rows"][-1]
    return [last["new_mesh"]["ms"], last["first_ms"]]


def _edt(record: Any, peer: str) -> list[float]:
    return _range([case["ms"][peer]["median"] / case["ms"]["sdm"]["median"] for case in record["cases"]])


def _classes(record: Any) -> list[float]:
    """Milliseconds of ours for each case, and how many times CuPy's are."""
    ours, theirs = ([case["ms"][name] for case in record["cases"]] for name in ("sdm", "CuPy"))
    return [*ours, *(b / a for a, b in zip(ours, theirs, strict=True))]


def _to_tens(numbers: Sequence[float]) -> list[float]:
    """With the last to tens."""
    return [*numbers[:-1], round(numbers[-1], -1)]


def _first_calls(record: Any) -> list[float]:
    rows = [row for row in record["rows"] if row["mesh"] == "torus-20000"]
    return [next(row["first_ms"] for row in rows if row["resolution"] == n) for n in (64, 256, 512)]


def _maps(record: Any) -> list[float]:
    return [round(x, -2) for x in _range([b["maps_per_second"] for b in record["rates"]["batches"]])]


def _method(record: Any, name: str) -> dict[str, Any]:
    return next(row for row in record["timing"]["rows"] if row["method"] == name)


def _shipped(record: Any) -> list[float]:
    return [record["accuracy"]["models"]["sdmnn-plus-ends"]["mae_mm"]]


def _coverage(record: Any) -> list[float]:
    return [100 * min(record[size]["coverage_90_shape"] for size in ("0.3", "0.2"))]


def _worst_coverage(record: Any) -> list[float]:
    wrong = [record["conditions"][name] for name in ("correlated", "shading", "labels")]
    return [*(100 * x for x in _range([c["coverage_90_shape"] for c in wrong])), *_range([c["trusted"] for c in wrong])]


def _training(record: Any, network: str) -> list[float]:
    found = record["training"][network]
    return [found["streamed_step_ms"], found["cached_step_ms"], found["streamed_to_cached"]]


def _speeds(record: Any) -> list[float]:
    return [100 * record["training"][network]["streamed_to_cached"] for network in ("u-net", "decoder")]


def _fits(record: Any) -> list[float]:
    return [record["summary"][name]["median_seconds"] for name in ("surrogate", "exact", "libigl", "libigl-map")]


def _accuracy(record: Any) -> list[float]:
    kinds = [kind for mesh in record["meshes"].values() for kind in mesh["kinds"].values()]
    points = sum(mesh["points"] for mesh in record["meshes"].values())
    return [len(record["meshes"]), max(kind["max_error"] for kind in kinds), round(points / 1e6)]


def _scores(run: str, part: str, *names: str) -> Numbers:
    return lambda record: [record[run][part]["mean"][name] for name in names]


def _half(record: Any) -> list[float]:
    mean = record["atria-local"]["half"]["mean"]
    return [mean["seen_half_mean_mm"], mean["other_half_mean_mm"], mean["other_half_95_mm"], mean["dice"]]


def _from_exact(record: Any) -> list[float]:
    found = record["summary"]["surrogate"]
    return [100 * found["largest_relative_to_exact"], 100 * found["largest_share_of_range_from_exact"]]


def _alone_from_exact(record: Any) -> list[float]:
    return [100 * record["summary"]["surrogate-alone"]["largest_share_of_range_from_exact"]]


def _seconds(record: Any) -> list[float]:
    return [_method(record, name)["ms"] / 1000 for name in ("libigl pseudonormal", "stock Warp", "exact engine")]


def _untrained(record: Any) -> list[float]:
    return [_method(record, "SDMNN, openvino")["ms"] / 1000]


def _label_fits(record: Any) -> list[float]:
    rows = record["cochlea-shipped"]["fits"]["deepsdf"]["rows"]
    return [sum(row["seconds"] for row in rows) / len(rows)]


def _sizes(record: Any) -> list[float]:
    return [record[run]["training"]["model_mib"] for run in ("atria-published", "atria-local")]


def _searches(record: Any) -> list[float]:
    return [record[run]["unseen"]["seconds_a_shape"] for run in ("atria-published", "atria-local")]


def _share(record: Any) -> list[float]:
    published, local = record["share"]["published"], record["share"]["local"]
    return [100 * published["share"], published["ms"], 100 * local["share"]]


FIGURES = (
    Figure(README, "{:.1f} ms at 64^3, {:.1f} ms at 256^3, {:.1f} ms at 512^3 |", "first-cuda", _first_calls),
    Figure(README, "| H100 | {:.0f}, {:.0f} times as fast as stock Warp by the better", "dense-cuda", _first),
    Figure(README, "not counted); {:.0f}, {:.0f} times |", "dense-cuda", lambda r: _means(r)[1:]),
    *(Figure(*row) for row in README_FIGURES),
    Figure(README, "| {:.2f} to {:.2f} of the processor time of OpenVDB", "band-cpu", shares_of_openvdb),
    Figure(README, "| two CPU cores | {:.0f} times as fast as the faster", "dense-cpu", _means_on_a_cpu),
    Figure(README, "| at {:.1f} % of the speed of training on a fixed batch", "stream", lambda r: _speeds(r)[:1]),
    Figure(SPEED, "takes {:.1f} ms at 64^3, {:.1f} ms at 256^3 and {:.1f} ms at 512^3", "first-cuda", _first_calls),
    Figure(SPEED, "it takes {:.1f} to {:.1f} ms for 20,000", "dense-cuda", lambda r: _times(r, "first")),
    Figure(SPEED, "Repeated, it takes {:.1f} to {:.0f} ms, 84 times", "dense-cuda", lambda r: _times(r, "new_mesh")),
    Figure(SPEED, "{:.0f}, {:.0f}, {:.0f} times as fast as stock Warp by the better", "dense-cuda", _means),
    Figure(SPEED, "; {:.0f}, {:.0f}, {:.0f} times its LBVH", "dense-cuda", lambda r: _means(r, "Warp winding number")),
    Figure(SPEED, "at 256^3, 512^3 | one H100 | {:.0f}, {:.0f} times", "dense-cuda", _first),
    Figure(SPEED, "at 512^3 timed on {:.0f} to {:.0f} % of the grid", "dense-cuda", _shares),
    Figure(SPEED, "H100 | {:,.0f} maps a second; {:,.0f} |", "dense-cuda", _batches),
    Figure(SPEED, "{:.0f} ms at 256^3, {:.0f} ms at the first call", "dense-cuda", _five_million),
    Figure(SPEED, "near the surface, repeated, tree built | one H100 | {:.0f}, {:.0f} times", "dense-cuda", _points),
    Figure(SPEED, "at 128^3 {:.0f} times as fast", "dense-cpu", _means_on_a_cpu),
    Figure(
        SPEED,
        "{:.1f} to {:.1f} ms at 512^3, {:.1f} to {:.1f} ms at 1024^3, {:.1f} to {:.1f} ms at 2048^3, "
        "{:.0f} to {:.0f} ms at 4096^3",
        "band-cuda",
        milliseconds_on_a_gpu,
    ),
    Figure(GUIDE, "{:.2f} to {:.2f} of the processor time of OpenVDB", "band-cpu", shares_of_openvdb),
    Figure(SPEED, "{:.2f} s repeated, {:.2f} s a file of a folder, {:.2f} s", "watertight-cuda", watertight_seconds),
    Figure(
        SPEED,
        "{:.1f} to {:.1f} ms of a map, {:.1f} to {:.1f} ms of a band, {:.0f} to {:,.0f} ms by dual contouring",
        "surface-cuda",
        surface_milliseconds,
    ),
    Figure(SPEED, "edges of fandisk within {:.3f} voxels, of all three {:.3f}", "surface-cuda", voxels_off_edges),
    Figure(SPEED, "geometric means {:.1f}, {:.1f}, {:.1f} and {:.1f} ms", "band-cuda", means_on_a_gpu),
    Figure(SPEED, "{:.0f} times as fast as Newton (off", "band-peers-cuda", lambda r: beside_others(r)[:1]),
    Figure(SPEED, "{:.0f} times as fast as PhysicsNeMo", "band-peers-cuda", lambda r: beside_others(r)[1:]),
    Figure(
        SPEED,
        "{:.0f} and {:.0f} times as long as ours with its build, {:.0f} and {:.0f} times without",
        "band-meshlib-cuda",
        beside_meshlib,
    ),
    Figure(LARGE, "takes {:.0f} to {:.0f} ms at 4096^3", "band-cuda", lambda r: milliseconds_on_a_gpu(r)[-2:]),
    Figure(LARGE, "a GPU {:.0f} to {:.0f} MiB for meshes of up to 100,000 triangles", "dense-cuda", _scratch),
    Figure(GUIDE, "{:,.0f} to {:,.0f} maps a second", "stream", _maps),
    *(Figure(DISK, *phrase) for phrase in disk_figures.PHRASES),
    Figure(GUIDE, "maps at {:.1f} % of the speed of training", "stream", lambda r: _speeds(r)[:1]),
    Figure(GUIDE, "a small decoder at {:.1f} %", "stream", lambda r: _speeds(r)[1:]),
    Figure(GUIDE, "{:.3f} mm off on average; on one core", "surrogate-pointwise-cpu", _shipped),
    Figure(PAPERS, "OpenVINO (extra `onnx`), {:.3f} mm off", "surrogate-pointwise-cpu", _shipped),
    Figure(GUIDE, "{:.0f} % of the 90 % intervals hold the truth", "fit-coverage", _coverage),
    Figure(GUIDE, "{:.0f} to {:.0f} % did, in {} to {} shapes", "fit-mismatch", _worst_coverage),
    Figure(SPEED, "{0} real and nasty meshes", "accuracy-cpu", _accuracy),
    Figure(SPEED, "on a GPU {0}, all", "accuracy-cuda", _accuracy),
    Figure(SPEED, "largest on a GPU {1:.1f}, {2} million points", "accuracy-cuda", _accuracy),
    Figure(SPEED, "{:.2f} to {:.1f} times as fast as CuPy", "edt-cuda", lambda r: _edt(r, "CuPy")),
    Figure(SPEED, "rows, {:.0f} to {:,.0f} times as SciPy", "edt-cuda", lambda r: _to_tens(_edt(r, "SciPy"))),
    Figure(SPEED, "16 classes of 512^3 in {:.0f} ms, 64 of 128^3 in {:.1f} ms", "edt-multiclass-cuda", _classes),
    Figure(SPEED, "{2:.1f} and {3:.0f} times as fast as CuPy class by class", "edt-multiclass-cuda", _classes),
    Figure(SCIPY, "{:.0f} to {:,.0f} times as fast as SciPy", "edt-cuda", lambda r: _to_tens(_edt(r, "SciPy"))),
    Figure(GUIDE, "atria to {:.2f} mm", "deepsdf", _scores("atria-local", "unseen", "mean_mm")),
    Figure(GUIDE, "three minutes: {:.2f} mm", "deepsdf", _scores("atria-published", "unseen", "mean_mm")),
    Figure(STREAM, "takes {:.1f} ms, on a fixed batch {:.1f}, {:.3f}", "stream", lambda r: _training(r, "u-net")),
    Figure(STREAM, "decoder's {:.1f} and {:.1f}, {:.3f}", "stream", lambda r: _training(r, "decoder")),
    Figure(
        STREAM,
        "at {:.2f} of four times one's speed, {:,.0f} samples",
        "stream-4",
        lambda r: [r["training"]["scaling"]["streamed"], r["training"]["together"]["streamed_samples_per_second"]],
    ),
    Figure(
        FIT,
        "takes {:.1f} s with the surrogate and {:.1f} s without, {:.0f} s with libigl",
        "fit-cases",
        lambda r: _fits(r)[:3],
    ),
    Figure(FIT, "same points and {:.0f} s with", "fit-cases", lambda r: _fits(r)[3:]),
    *(Figure(FIT, *row) for row in FIT_FIGURES),
    Figure(DEEPSDF, "{:.0f} million samples a second", "sampling-cuda", lambda r: [r["samples"]["per_second"] / 1e6]),
    Figure(DEEPSDF, "cores {:.2f} million", "sampling-cpu", lambda r: [r["samples"]["per_second"] / 1e6]),
    Figure(
        DEEPSDF,
        "are {:.1f} % of the published network's step on that batch ({:.1f} ms)",
        "sampling-cuda",
        lambda r: _share(r)[:2],
    ),
    Figure(DEEPSDF, "32 x 4,096 samples they are {:.0f} %", "sampling-cuda", lambda r: _share(r)[2:]),
    Figure(
        DEEPSDF,
        "{:.2f} mm off on the seen half and {:.1f} mm on the other (95 %: {:.1f} mm), Dice {:.2f};",
        "deepsdf",
        _half,
    ),
    Figure(PAPERS, "with SDMNN+ {:.1f} s | other data", "fit-cases", lambda r: _fits(r)[:1]),
    Figure(PAPERS, "with anchors, {:.2f} % and {:.2f} % by SDMNN+", "fit-cases", _from_exact),
    Figure(PAPERS, "exact: {:.2f} % of the value and {:.2f} % of the range", "fit-cases-paper", _from_exact),
    Figure(PAPERS, "by the first alone {:.1f} % of the range", "fit-cases-paper", _alone_from_exact),
    Figure(WANG, "up to {:.1f} % of their range from the exact", "fit-cases-paper", _alone_from_exact),
    Figure(PAPERS, "libigl {:.3f} s, stock Warp {:.3f} s, our exact engine {:.3f} s", "surrogate-cpu", _seconds),
    Figure(PAPERS, "| {:.3f} s (OpenVINO, untrained: its time alone)", "surrogate-cpu", _untrained),
    Figure(
        PAPERS,
        "the shipped small network {:.1f} s",
        "deepsdf",
        lambda r: [r["cochlea-shipped"]["maps"]["deepsdf_ms"] / 1000],
    ),
    Figure(PAPERS, "{:.1f} MiB (published network), {:.1f} MiB (local", "deepsdf", _sizes),
    Figure(PAPERS, "{:.1f} s (published network), {:.2f} s (local)", "deepsdf", _searches),
    Figure(PAPERS, "| {:.0f} s on three label maps", "deepsdf", _label_fits),
    Figure(PAPERS, "{:.2f} mm off on the seen half, {:.1f} mm on the other", "deepsdf", lambda r: _half(r)[:2]),
    *(Figure(*row) for row in SHAPE_FIGURES),
    *(Figure(*row) for row in OTHER_TOOLS_FIGURES),
)


def out_of_step() -> list[str]:
    """Sentences about phrases and rows that their pages do not hold."""
    found = [(figure.page, figure.record, figure.phrase()) for figure in FIGURES]
    found += [(page, name, row) for page, name, rows in TABLES for row in rows()]
    return [f"{page}: not there by {name}: {phrase}" for page, name, phrase in found if phrase not in text(page)]


def main() -> int:
    """Print what is out of step; 1 if there is anything."""
    wrong = out_of_step()
    print("\n".join(wrong) or f"{len(FIGURES)} phrases and {len(TABLES)} tables are as their records say")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
