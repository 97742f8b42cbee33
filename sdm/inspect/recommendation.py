"""The method by which a mesh's maps are best signed, with the reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# A mesh is as good as closed if components with small gaps make up this share of its area.
NEARLY_CLOSED = 0.9


def recommended_sign(facts: Mapping[str, Any]) -> tuple[str, str]:
    """The `sign` of `sdm.signed_distance_map` that suits a mesh, and a sentence that says why.

    Args:
        facts: The fields of a `MeshReport`.
    """
    shut = facts["shut_area"]
    if facts["disagreeing_pairs"]:
        return "flood", (
            "faces disagree which side is out, so winding numbers mean little; a flood does not ask them "
            "(or make them agree by orient='parts')"
        )
    if facts["closed"] and facts["volume"]:
        return "winding", "the mesh is closed, so that its winding number is a whole number everywhere"
    if facts["closed"]:
        return (
            "flood",
            "the mesh is closed but encloses no volume, as doubled walls do; a flood finds what they shut off",
        )
    if shut >= NEARLY_CLOSED:
        return "winding", (
            f"components that are closed, or open by little, make up {100 * shut:.3g} % of the area: near the gaps the "
            "winding number is the best guess there is"
        )
    if facts["components"] == 1:
        return (
            "none",
            "the mesh is one sheet, wide open, with nothing inside; if its opening is to be closed, take flood",
        )
    return "flood", (
        f"sheets and wide open components make up {100 * (1 - shut):.3g} % of the area: they have no winding number to "
        "go by, but may shut off an inside together"
    )
