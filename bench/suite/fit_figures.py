"""Figures of the fit's page, for `sdm.bench.suite.page_figures`: words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Numbers = Callable[[Any], Sequence[Any]]


def _ends(numbers: Sequence[float]) -> list[float]:
    return [min(numbers), max(numbers)]


def _coverage_of(name: str) -> Numbers:
    def numbers(record: Any) -> list[float]:
        found = record["conditions"][name]
        return [100 * found["coverage_90_shape"], found["trusted"]]

    return numbers


def _formation_of(name: str) -> Numbers:
    def numbers(record: Any) -> list[float]:
        found = record["conditions"][name]
        return [100 * found["coverage_90_shape"], 100 * found["coverage_90_shape_before"]]

    return numbers


def _formation_counts(record: Any) -> list[float]:
    found = record["conditions"].values()
    return [min(c["cases"] for c in found), *_ends([c["trusted"] for c in found])]


def _border(record: Any) -> list[float]:
    refused = [r["problems"] for c in record["conditions"].values() for r in c["not_trusted"]]
    return [len(refused), sum("reaches the image's border" in problems[0] for problems in refused)]


def _coverage_by_noise(record: Any) -> list[float]:
    shares = {row["noise_HU"]: 100 * row["coverage_90_shape"] for row in record["by_noise"]}
    return [*_ends([share for noise, share in shares.items() if noise >= 5]), shares[1.0], shares[0.0]]


def _refused(record: Any) -> list[float]:
    return [record["refused"], 100 * record["refused_at_most_95"]]


def _race(ours: str, theirs: str) -> Numbers:
    def numbers(record: Any) -> list[float]:
        found = record["summary"]
        seconds = [found[name]["median_cpu_seconds"] for name in (ours, theirs)]
        return [found[ours][f"times_less_cpu_than_{theirs}"], len(record["cases"]), *seconds]

    return numbers


def _race_by_clock(ours: str, theirs: str) -> Numbers:
    def numbers(record: Any) -> list[float]:
        found = record["summary"]
        seconds = [found[name]["median_seconds"] for name in (ours, theirs)]
        return [found[ours][f"times_faster_than_{theirs}"], record["machine"]["cores"], *seconds, len(record["cases"])]

    return numbers


def _quartiles(ours: str, theirs: str) -> Numbers:
    return lambda record: record["summary"][ours][f"quartiles_of_times_faster_than_{theirs}"]


def _residual(record: Any) -> list[float]:
    found = record["scanners"]["0.3"]["residual"]
    return [found["mean_mm"], found["dice"]]


FIT_FIGURES: tuple[tuple[str, str, Numbers], ...] = (
    ("all as assumed | {:.0f} % ({})", "fit-mismatch", _coverage_of("matched")),
    ("taken for 0.2 | {:.0f} % ({})", "fit-mismatch", _coverage_of("blur-0.20")),
    ("taken for 0.3 | {:.0f} % ({})", "fit-mismatch", _coverage_of("blur-0.30")),
    ("over 0.6 voxels | {:.0f} % ({})", "fit-mismatch", _coverage_of("correlated")),
    ("degrees of freedom | {:.0f} % ({})", "fit-mismatch", _coverage_of("heavy-tailed")),
    ("along x | {:.0f} % ({})", "fit-mismatch", _coverage_of("shading")),
    ("by `--model labels` | {:.0f} % ({})", "fit-mismatch", _coverage_of("labels")),
    ("shading together | {:.0f} % ({})", "fit-mismatch", _coverage_of("several")),
    ("Of {} shapes at 0.3 mm and 200 HU of noise", "fit-formation", lambda r: _formation_counts(r)[:1]),
    ("trusted fits, {} to {} of them", "fit-formation", lambda r: _formation_counts(r)[1:]),
    ("Of the {} fits that are not trusted, {} reach the image's border", "fit-formation", _border),
    (
        "truth in {:.0f} to {:.0f} % from 5 HU on, in {:.0f} % at 1 HU and in {:.0f} %",
        "fit-refusals",
        _coverage_by_noise,
    ),
    ("a case takes {:.0f} s of a core", "fit-refusals", lambda r: [r["median_cpu_seconds"]]),
    ("as it is told | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("matched")),
    ("a blur of 0.3 mm | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("blur")),
    ("over 0.6 voxels | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("correlated")),
    ("10 % along x | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("shading")),
    ("slices of 0.6 mm | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("thick")),
    ("about any axis | {:.0f} % ({:.0f} %)", "fit-formation", _formation_of("turned")),
    ("Of {} images over noise", "fit-refusals", lambda r: [r["with_an_answer"]]),
    ("mm, {} were refused, so at most {:.2f} %", "fit-refusals", _refused),
    ("comes back with {:.3f} mm and a Dice of {:.3f};", "fit-real", _residual),
    (
        "takes {:.2f} times as long by the clock on {} quiet cores, {:.1f} s and {:.1f} s, the median of {} cases",
        "fit-race",
        _race_by_clock("exact", "libigl-closest"),
    ),
    ("(half of them between {:.2f} and {:.2f}), and", "fit-race", _quartiles("exact", "libigl-closest")),
    (
        "and {:.1f} times the processor time ({:.1f} s and {:.1f} s of a core",
        "fit-race",
        lambda r: [x for k, x in enumerate(_race("exact", "libigl-closest")(r)) if k != 1],
    ),
    (
        "libigl at its best takes {:.2f} times as long, {:.1f} s and {:.1f} s, the median of the same {} cases",
        "fit-race-two-cores",
        lambda r: [x for k, x in enumerate(_race_by_clock("exact", "libigl-closest")(r)) if k != 1],
    ),
    ("(half of them between {:.2f} and {:.2f}), and ends", "fit-race-two-cores", _quartiles("exact", "libigl-closest")),
    (
        "{:.1f} times as long by the clock on {} cores a fit, {:.1f} s and {:.1f} s, the median of {} cases",
        "fit-race-maps",
        _race_by_clock("exact-map", "libigl-closest-map"),
    ),
    ("(half of them between {:.1f} and {:.1f}), and", "fit-race-maps", _quartiles("exact-map", "libigl-closest-map")),
    (
        "and {:.1f} times the processor time ({:.0f} s and {:.0f} s of a core",
        "fit-race-maps",
        lambda r: [x for k, x in enumerate(_race("exact-map", "libigl-closest-map")(r)) if k != 1],
    ),
    ("a pose come to {:.2f} mm on average", "fit-atria", lambda r: [r["mean"]["modes_mm"]]),
    ("with free vertices it is {:.2f} mm", "fit-atria", lambda r: [r["mean"]["free_form_mm"]]),
)
