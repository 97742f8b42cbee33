r"""Shapes from images: simulated cases with known truth, coverage of the intervals, speed, and a real shape.

    python -m sdm.bench.fit cases [--quick]         nine cases, as in Table 2 of Wang et al., MIDL 2020
    python -m sdm.bench.fit coverage --count 200    do 90 % intervals hold the truth in 90 % of cases? Resumable
    python -m sdm.bench.fit mismatch --count 24     the same in images that do not fit the model. Resumable
    python -m sdm.bench.fit formation --count 40    the same with the image's formation estimated. Resumable
    python -m sdm.bench.fit refusals --count 500    how many images with an answer are refused? Resumable
    python -m sdm.bench.fit campaign                both of these in one queue, a line of JSON a case. Goes on from
                                                    the rows of both records
    python -m sdm.bench.fit real [--data FOLDER]    the mean human scala tympani: mesh, image, fit
    python -m sdm.bench.fit pictures                docs/fit-*.png from what the others left; `--records`: without fits

Studies of many cases take `--processes 16` (a thread each) and `--budget-s`, and go on where they ended. Cases are
drawn at random in a fixed order, and those count that were finished from the first on without a gap, so that a study
which is interrupted is not one of quick cases.

All but the last write bench/results/fit-NAME.json. `--backends exact,surrogate,hybrid,libigl,libigl-map` says what fits
(these for the table that is kept; by default exact and libigl); the last two are the same fit with a stock library's
distances and finite differences, as a method without our derivatives has it (`libigl-closest` takes our derivatives
from its closest points, in one query a step): `libigl` is asked about the points near
the surface alone, which our search for them allows, `libigl-map` makes whole maps, as a mesh's signed distance map in
the place of a surrogate. `warp` and `warp-map` are stock Warp's. A race at equal accuracy, on cores that are free:

    python -m sdm.bench.fit cases --count 20 --backends exact,libigl-closest,exact-map,libigl-closest-map \
        --out bench/results/fit-race.json

where `exact-map` and `libigl-closest-map` make the same maps with their derivatives, each by one query a shape, and
have anchors as a surrogate has.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from sdm.bench.common.checkout import docs_folder, results_folder
from sdm.bench.fit.campaign import campaign
from sdm.bench.fit.cases import cases
from sdm.bench.fit.coverage import coverage
from sdm.bench.fit.formation import formation
from sdm.bench.fit.mismatch import mismatch
from sdm.bench.fit.pictures import pictures
from sdm.bench.fit.real import real
from sdm.bench.fit.refusals import refusals

STUDIES = {
    "cases": cases,
    "coverage": coverage,
    "mismatch": mismatch,
    "formation": formation,
    "refusals": refusals,
    "campaign": campaign,
    "real": real,
    "pictures": pictures,
}


def main() -> None:
    """Parse the command line and run one study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = parser.add_subparsers(dest="study", required=True)
    each = {name: studies.add_parser(name) for name in STUDIES}
    for name, study in each.items():
        study.add_argument("--out", type=Path, default=results_folder() / f"fit-{name}.json", help="results, JSON")
        study.add_argument("--device", default="cpu", help="cpu, cuda or cuda:N, for our own backends")
    for name in ("cases", "coverage", "real"):
        each[name].add_argument("--weights", type=Path, default=None, help="a surrogate's; the shipped ones by default")
    each["cases"].add_argument(
        "--backends",
        default="exact,libigl",
        help="of exact,surrogate,surrogate-alone,hybrid,exact-map,libigl-closest,libigl-closest-map,libigl,libigl-map,"
        "warp,warp-map",
    )
    each["cases"].add_argument("--count", type=int, default=9)
    each["cases"].add_argument("--first", type=int, default=0, help="begin with this case")
    each["cases"].add_argument(
        "--step", type=int, default=1, help="only each so many cases: other processes do the others"
    )
    each["cases"].add_argument("--resume", action="store_true", help="keep the cases in --out, of a machine like this")
    each["cases"].add_argument("--quick", action="store_true", help="two cases")
    each["coverage"].add_argument("--count", type=int, default=200, help="cases at each voxel size")
    each["coverage"].add_argument("--backend", default="exact", help="exact, surrogate or hybrid")
    each["coverage"].add_argument("--folder", type=Path, default=Path("build/fit-coverage"), help="one file a case")
    for name in ("cases", "coverage", "mismatch", "formation", "refusals", "campaign"):
        each[name].add_argument(
            "--budget-s", "--limit-s", type=float, default=float("inf"), help="begin no fit after this long"
        )
    for name in ("coverage", "mismatch", "formation", "refusals", "campaign"):
        each[name].add_argument("--processes", type=int, default=1, help="how many at once, a thread each")
        each[name].add_argument("--first", type=int, default=0, help="begin with this case: other machines do the rest")
    each["mismatch"].add_argument("--count", type=int, default=24, help="cases under each condition")
    each["mismatch"].add_argument("--folder", type=Path, default=Path("build/fit-mismatch"), help="one file a fit")
    for name, count in (("formation", 40), ("refusals", 500)):
        each[name].add_argument("--count", type=int, default=count, help="cases (under each condition)")
        each[name].add_argument("--folder", type=Path, default=Path(f"build/fit-{name}"), help="one file a case")
    each["campaign"].add_argument("--count", type=int, default=400, help="cases under each condition")
    each["campaign"].add_argument("--images", type=int, default=500, help="images of the study of refusals")
    each["campaign"].add_argument(
        "--first-image", type=int, default=0, help="begin the study of refusals with this one"
    )
    each["campaign"].add_argument("--folder", type=Path, default=Path("build/fit-campaign"), help="one file a case")
    each["campaign"].add_argument("--lines", type=Path, default=Path("build/fit-campaign.jsonl"), help="a line a case")
    each["real"].add_argument("--data", type=Path, default=None, help="folder of test data; SDM_DATA if not given")
    each["real"].add_argument("--backend", default="exact", help="exact, surrogate or hybrid")
    each["pictures"].add_argument("--docs", type=Path, default=docs_folder())
    each["pictures"].add_argument("--records", action="store_true", help="those alone that need no fit")
    options = parser.parse_args()
    STUDIES[options.study](options)


if __name__ == "__main__":
    main()
