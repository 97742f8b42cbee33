"""Prior, before the image is seen: the ranges of the shape, and roughly where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from sdm.fit.model.pose import State
from sdm.shapes import Parameter


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent Gaussians with the moments of uniform distributions over the ranges, and a rough pose.

    Args:
        low: (P,) ends of the shape parameters' ranges, which estimates never leave.
        high: (P,).
        pose: The pose that is expected.
        turn: Standard deviation of the rotation about each axis [rad].
        shift: Standard deviation of the translation along each axis [mm].
    """

    low: Tensor
    high: Tensor
    pose: State
    turn: float = 0.5
    shift: float = 2.0

    @classmethod
    def of(cls, parameters: tuple[Parameter, ...], pose: State, turn: float = 0.5, shift: float = 2.0) -> Prior:
        """The prior of a family's ranges."""
        ends = torch.tensor([[p.low, p.high] for p in parameters], dtype=torch.float64, device=pose.theta.device)
        return cls(ends[:, 0], ends[:, 1], pose, turn, shift)

    @property
    def middle(self) -> Tensor:
        """(P,) the middle of the ranges."""
        return (self.low + self.high) / 2

    @property
    def precision(self) -> Tensor:
        """(P+6,) inverse variances."""
        theta = 12 / (self.high - self.low).clamp_min(1e-12) ** 2
        rest = [1 / self.turn**2] * 3 + [1 / self.shift**2] * 3
        return torch.cat([theta, torch.tensor(rest, dtype=theta.dtype, device=theta.device)])

    def residual(self, state: State) -> Tensor:
        """(P+6,) how far a state is from what is expected; its derivative by `State.moved` is near 1."""
        return state.since(replace(self.pose, theta=self.middle))

    def penalty(self, state: State) -> float:
        """Minus the log density, but for a constant."""
        return 0.5 * float((self.precision * self.residual(state) ** 2).sum())

    def blocked(self, state: State, step: Tensor) -> Tensor:
        """(P+6,) which shape parameters are at an end of their range and would leave it."""
        count, slack = len(self.low), 1e-9
        move = step[:count]
        ends = ((state.theta <= self.low + slack) & (move < 0)) | ((state.theta >= self.high - slack) & (move > 0))
        return torch.cat([ends, torch.zeros(6, dtype=torch.bool, device=ends.device)])

    def clip(self, state: State, step: Tensor) -> Tensor:
        """The step, cut so that shape parameters stay in their ranges and the pose's step is moderate."""
        count = len(self.low)
        pose = torch.tensor([math.pi / 8] * 3 + [1.0] * 3).to(step)
        step = step / (step.abs() / torch.cat([(self.high - self.low) / 4, pose])).max().clamp_min(1.0)
        theta = (state.theta + step[:count]).clamp(self.low, self.high)
        return torch.cat([theta - state.theta, step[count:]])
