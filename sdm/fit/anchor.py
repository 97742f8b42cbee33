"""A surrogate's renderings with its own error taken out at one state, and nearly so around it."""

from __future__ import annotations

from sdm.fit.pose import State
from sdm.fit.render import Rendered, Renderer


class Anchored:
    """Renders by a surrogate, corrected by what an exact backend renders at one state, the anchor.

    The surrogate's error in a voxel's share is taken to change linearly with the increment of `State.moved` from the
    anchor: its value and its derivatives there are exact minus surrogate. So shares and derivatives are exact at the
    anchor, and off by second and first order in the increment elsewhere.

    Args:
        surrogate: Renders by the surrogate, and goes on doing so: one rendering for each call.
        exact: Renders exactly on the same grid; asked once, for the anchor.
        anchor: The state to be exact at.
    """

    def __init__(self, surrogate: Renderer, exact: Renderer, anchor: State) -> None:
        self.surrogate, self.anchor = surrogate, anchor
        right, ours = exact(anchor), surrogate(anchor)
        assert right.by_step is not None and ours.by_step is not None  # noqa: S101 PT018 - for the type checker
        self._share = right.share - ours.share
        self._by_step = right.by_step - ours.by_step

    def __call__(self, state: State) -> Rendered:
        """The share of inside in each voxel, and how it changes with the increments of `State.moved`."""
        found = self.surrogate(state)
        assert found.by_step is not None  # noqa: S101 - for the type checker
        step = state.since(self.anchor).to(self._by_step)
        share = found.share + self._share + (step @ self._by_step.flatten(1)).view_as(self._share)
        return Rendered(share.clamp(0, 1), found.by_step + self._by_step)
