"""A surrogate's renderings with its own error taken out at one state.

A surrogate's derivatives would spoil the rest: where residuals are noise, derivatives that are 4 % off move the estimate
by up to a third of a posterior standard deviation, however exact the residuals are.
"""

from __future__ import annotations

from sdm.fit.pose import State
from sdm.fit.render import Rendered, Renderer


class Anchored:
    """Renders by a surrogate, corrected by what an exact backend renders at one state, the anchor.

    To each voxel's share of inside the difference exact - surrogate at the anchor is added. Derivatives are the exact
    ones at the anchor. So both are exact there, and off by a share of the way from there elsewhere.

    Args:
        surrogate: Renders by the surrogate: one map for each state, without derivatives.
        exact: Renders exactly on the same grid; asked once, for the anchor.
        anchor: The state to be exact at.
    """

    def __init__(self, surrogate: Renderer, exact: Renderer, anchor: State) -> None:
        self.surrogate, self.anchor = surrogate, anchor
        self._right = exact(anchor)
        self._difference = self._right.share - surrogate(anchor, derivatives=False).share

    def __call__(self, state: State) -> Rendered:
        """The share of inside in each voxel, and the anchor's derivatives by the increments of `State.moved`."""
        if state is self.anchor:
            return self._right
        share = self.surrogate(state, derivatives=False).share + self._difference
        return Rendered(share.clamp(0, 1), self._right.by_step)
