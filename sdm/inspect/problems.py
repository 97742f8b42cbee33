"""A report's findings as sentences: what it means for distances, and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# In Python and in commands.
AUTO = 'orient="auto" (--orient auto)'
ORIENT_PARTS = 'orient="parts" (--orient parts)'
FLOOD = 'sign="flood" (--sign flood)'
NOTHING_INSIDE = (
    f"the mesh is closed but encloses no volume, so nothing is inside; {FLOOD} finds what doubled walls shut off"
)


def problems_of(facts: Mapping[str, Any], unjudged: int) -> list[str]:
    """Sentences about a report's numbers, the gravest first.

    Args:
        facts: The fields of a `MeshReport` without its problems.
        unjudged: Components that face inward and were not compared with the others.
    """
    found = sign_problems(facts)
    if unjudged:
        found.append(f"{_count(unjudged, 'component')} facing inward could not be told from cavities in short time")
    if facts["boundary_edges"]:
        found.append(
            f"the mesh is open: {_count(facts['boundary_edges'], 'edge')} of one face only; near the gaps the inside "
            "follows the generalised winding number and may be ambiguous"
        )
    if facts["disagreeing_edges"] and not facts["disagreeing_pairs"]:
        found.append(
            f"faces disagree which side is out along {_count(facts['disagreeing_edges'], 'edge')} where more than two "
            "meet; the sign may be wrong there"
        )
    if facts["nonmanifold_edges"]:
        found.append(f"{_count(facts['nonmanifold_edges'], 'edge')} of more than two faces; distances are not affected")
    if facts["nonmanifold_vertices"]:
        many = _count(facts["nonmanifold_vertices"], "vertex", "vertices")
        found.append(f"{many} where separate parts touch; distances are not affected")
    if facts["duplicate_faces"]:
        found.append(
            f"{_count(facts['duplicate_faces'], 'face')} with the same vertices as another; each counts in the "
            "winding number"
        )
    if facts["degenerate_faces"]:
        found.append(f"{_count(facts['degenerate_faces'], 'face')} of zero area; they count as segments or points")
    return found


def sign_problems(facts: Mapping[str, Any]) -> list[str]:
    """Sentences about what makes the sign of a map something else than was meant, the gravest first."""
    found = []
    pieces, wrong = facts["components"], facts["inside_out_components"]
    if facts["disagreeing_pairs"] and not facts["turned_area"]:
        found.append(
            f"faces disagree which side is out along {_count(facts['disagreeing_edges'], 'edge')}, and no turn of "
            f"patches makes them agree, as on a one-sided surface: the sign is not to be trusted near "
            f"{'it' if facts['disagreeing_edges'] == 1 else 'them'}; {FLOOD} does not ask faces"
        )
    elif facts["disagreeing_pairs"]:
        found.append(
            f"faces disagree which side is out along {_count(facts['disagreeing_edges'], 'edge')}, and "
            f"{100 * facts['turned_area']:.3g} % of the area is turned against the rest: the sign is not to be trusted "
            f"near {'it' if facts['disagreeing_edges'] == 1 else 'them'}; {ORIENT_PARTS} turns patches outward, "
            f"{FLOOD} does not ask them"
        )
    if facts["inside_out"]:
        why = f"it is closed, but its volume is {facts['volume']:.6g}" if facts["closed"] else "its faces look inward"
        found.append(f"the mesh is inside out: {why}, so that nothing counts as inside; {AUTO} turns it")
    elif wrong:
        verb, content, them = ("is", "it holds", "it") if wrong == 1 else ("are", "they hold", "them")
        found.append(
            f"{wrong:,} of {pieces:,} components {verb} inside out, so that what {content} counts as outside; "
            f"{AUTO} turns {them}"
        )
    elif facts["closed"] and facts["volume"] == 0:
        found.append(NOTHING_INSIDE)
    return found


def _count(number: int, one: str, many: str | None = None) -> str:
    return f"{number:,} {one if number == 1 else many or one + 's'}"
