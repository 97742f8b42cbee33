"""The rows of the tables: what a network puts out, which map it is told of, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sdm.errors import SDMError

Map = Literal["foreground", "normalized", "signed", "clipped"]
Distance = Literal["l1", "l2", "l1+l2"]


@dataclass(frozen=True, kw_only=True)
class Method:
    """One way to train a segmentation network.

    Args:
        name: Its name on the command line and in the tables.
        output: What the network's main channel is: a logit of the foreground, a signed distance that tanh keeps in
            -1..1, or one without limits.
        loss: Which loss of `objective.LOSSES` that channel has.
        map: The target's distance map that the loss or the auxiliary output wants: see `targets.distance_map`.
        auxiliary: A second output that regresses the map: a further channel of the decoder ("head"), or a decoder of
            its own from the coarsest level, without skips ("branch").
        distance: Its loss.
        about: One line for the reader.
    """

    name: str
    about: str
    output: Literal["logit", "tanh", "linear"] = "logit"
    loss: str = "region"
    map: Map | None = None
    auxiliary: Literal["head", "branch"] | None = None
    distance: Distance | None = None


def _auxiliary() -> list[Method]:
    found = []
    maps: dict[str, tuple[Map, str]] = {
        "dtm": ("foreground", "distance transform map of the foreground"),
        "sdf": ("normalized", "signed distance map"),
    }
    losses: dict[str, Distance] = {"l1": "l1", "l2": "l2", "l1l2": "l1+l2"}
    for place in ("head", "branch"):
        for short, (name, words) in maps.items():
            for word, distance in losses.items():
                about = f"baseline and a {place} that regresses the {words}, {distance}"
                found.append(
                    Method(name=f"{place}-{short}-{word}", about=about, map=name, auxiliary=place, distance=distance)
                )
    return found


_ALL = [
    Method(name="baseline", about="cross-entropy and Dice"),
    Method(name="boundary", about="baseline and, more and more, the boundary loss", loss="boundary", map="signed"),
    Method(name="hausdorff", about="baseline and, more and more, the Hausdorff distance loss", loss="hausdorff"),
    Method(
        name="sdf-product",
        about="regression of the signed distance map by the product loss, with Dice",
        output="tanh",
        loss="product",
        map="normalized",
    ),
    *_auxiliary(),
    Method(
        name="hausdorff-foreground",
        about="the Hausdorff distance loss of the foreground's transform alone, as published",
        loss="hausdorff-foreground",
    ),
    Method(name="pwc", about="Juhl's voxel-wise classification: cross-entropy", loss="cross-entropy"),
    Method(
        name="pwr",
        about="Juhl's voxel-wise regression of the clipped signed distance map",
        output="linear",
        loss="weighted-mse",
        map="clipped",
    ),
]
METHODS: dict[str, Method] = {method.name: method for method in _ALL}
# Rows of Ma's table, in its order.
MA_ROWS = tuple(METHODS)[:16]


def method_called(name: str) -> Method:
    """The method of a name.

    Raises:
        SDMError: There is none; the names are listed.
    """
    if not isinstance(name, str) or name not in METHODS:
        raise SDMError(f"there is no method called {name!r}; choose one of {', '.join(METHODS)}")
    return METHODS[name]
