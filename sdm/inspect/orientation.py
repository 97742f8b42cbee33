"""Orientation of components: outward, inside out, or a cavity of others."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sdm.inspect.agreement import agreeing_turns
from sdm.inspect.components import Components, components_of
from sdm.inspect.edges import edges_of
from sdm.inspect.nesting import Nesting

# A component is inside another if that one's winding number about it is more than this.
INSIDE = 0.5


def outward_turns(corners: Float64[np.ndarray, "F 3 3"], merged: Int64[np.ndarray, "F 3"]) -> Bool[np.ndarray, " F"]:
    """The faces that `orient_outward` turns.

    Args:
        corners: (F,3,3) float64.
        merged: (F,3) vertex indices that tell positions apart.
    """
    edges = edges_of(merged, int(merged.max()) + 1)
    component, count = edges.component, edges.components
    turn = np.zeros(len(merged), dtype=bool)
    if count == 0:
        return turn
    gaps = edges.open_components
    if edges.disagreeing.any():
        uneven = np.zeros(count, dtype=bool)
        uneven[edges.component_of_edge[edges.disagreeing]] = True
        mended = np.flatnonzero((component >= 0) & uneven[component])
        area = np.linalg.norm(np.cross(*np.moveaxis(corners[mended, 1:] - corners[mended, :1], 1, 0)), axis=1)
        turn[mended], patch, patches = agreeing_turns(merged[mended], area)
        # Where more than two faces meet, nobody knows which of them belong together: each patch is one component.
        component, gaps = component.copy(), np.concatenate([gaps, np.ones(patches, dtype=bool)])
        component[mended] = count + patch
        names, number = np.unique(component[component >= 0], return_inverse=True)
        component[component >= 0] = number
        gaps, count = gaps[names], len(names)
        corners = np.where(turn[:, None, None], corners[:, ::-1], corners)
        merged = np.where(turn[:, None], merged[:, ::-1], merged)
    components = components_of(corners, merged, component, gaps)
    if not components.reversed.any():
        return turn
    return turn ^ ((component >= 0) & to_turn(corners, components)[component])


def to_turn(corners: Float64[np.ndarray, "F 3 3"], components: Components) -> Bool[np.ndarray, " C"]:
    """The components (C,) to turn: those that face inward and are inside no other, with all that is inside them."""
    wrong = np.zeros(len(components.volume), dtype=bool)
    nesting = Nesting(corners, components.of_face, components.nearly_closed, components.caps == 0)
    for suspect in np.flatnonzero(components.reversed):
        times = [nesting.winding(outer, suspect) for outer in nesting.around(suspect)]
        wrong[suspect] = all(found is not None and abs(found) < INSIDE for found in times)
    outermost = np.flatnonzero(wrong)
    for outer in outermost:
        for inner in nesting.within(outer):
            if not wrong[inner] and abs(nesting.winding(outer, inner) or 0.0) > INSIDE:
                wrong[inner] = True
    return wrong


def inside_out(corners: Float64[np.ndarray, "F 3 3"], components: Components) -> tuple[int, int]:
    """Count the components that face inward without being a cavity of the others.

    Args:
        corners: (F,3,3) float64.
        components: The components.

    Returns:
        How many are inside out, and how many could not be judged because it would take too long. A component that faces
        inward is a cavity, and right, where the winding number of the others is above 0.5.
    """
    suspects = np.flatnonzero(components.reversed)
    if len(suspects) == 0:
        return 0, 0
    nesting = Nesting(corners, components.of_face, components.nearly_closed, components.caps == 0)
    wrong = 0
    for position, suspect in enumerate(suspects):
        times = [nesting.winding(outer, suspect) for outer in nesting.around(suspect)]
        if None in times:
            return wrong, len(suspects) - position
        wrong += sum(found for found in times if found is not None) < INSIDE
    return wrong, 0
