"""Nearly the inverse of what a step on a whole code solves for, so that conjugate gradients need few products.

With each sample point by itself, as if no blur mixed them, and for all of them one factor of what the blur leaves, the
matrix is a sum over cells of the code's grids. A surface passes through a part of them, so a few thousand of a code's
numbers hang together, and all others are nearly as their prior says: Cholesky's factors of the first are quickly made.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.deepsdf.infer.code_jacobian import CodeJacobian
from sdm.deepsdf.networks.code_gaussian import CodeGaussian

# A direction of the training's codes counts where its variance is larger than that of all others by this share.
LARGER = 1e-3
# A number of a code counts where the data tell more than this beside its prior; at most so many do.
LEAST, MOST = 1e-2, 6000
# Shares of the diagonal that are added to it until no rounding of float32 is left below 0.
ROUNDING = (1e-7, 1e-5, 1e-3)


class Preconditioner:
    """The inverse of A' W A + E' E / s^2 + 1 in the coordinates in which the prior is a standard Gaussian.

    Args:
        gaussian: The prior of codes.
        jacobian: A by the code.
        similar: (N,7) A by size, rotation and translation, in standard deviations.
        importance: (N,) the diagonal W.
        even: (M,D) and (M,7), E / s.
    """

    def __init__(
        self,
        gaussian: CodeGaussian,
        jacobian: CodeJacobian,
        similar: Tensor,
        importance: Tensor,
        even: tuple[Tensor, Tensor],
    ) -> None:
        self.gaussian = gaussian
        more, of_similar = even
        told = gaussian.rest * (jacobian.squares(importance.to(more)) + more.square().sum(0))
        most = told.topk(min(MOST, len(told)))
        self.seen = most.indices[most.values > LEAST].sort().values
        column = torch.full_like(told, len(self.seen), dtype=torch.int64)
        column[self.seen] = torch.arange(len(self.seen), device=told.device)
        whole = jacobian.gram(column, len(self.seen), similar, importance.to(more))
        own = torch.cat([more[:, self.seen], of_similar.to(more)], 1)
        whole = (whole + own.T @ own).double()
        count = len(self.seen)
        whole.diagonal()[:count] += 1 / gaussian.rest
        whole.diagonal()[count:] += 1
        self.factor = _factor(whole)
        # Of the prior, what the training's codes say beside that: a few directions, by Woodbury's identity.
        some = gaussian.variances > (1 + LARGER) * gaussian.rest
        self.axes = gaussian.axes[some].double()
        self.solved = self._solved(self.axes.T, self.axes.new_zeros(similar.shape[1], len(self.axes)))
        shrunk = 1 / (1 / gaussian.rest.double() - 1 / gaussian.variances[some].double())
        self.inner = torch.linalg.cholesky(shrunk.diag() - self.axes @ self.solved[: -similar.shape[1]])

    def __call__(self, right: Tensor) -> Tensor:
        """Of a right side (D+7,)."""
        code = self.gaussian.standard(right[:-7].float()).double()
        found = self._solved(code[:, None], right[-7:, None])
        found = found + self.solved @ torch.cholesky_solve(self.axes @ found[:-7], self.inner)
        return torch.cat([self.gaussian.standard(found[:-7, 0].float()).double(), found[-7:, 0]])

    def _solved(self, code: Tensor, similar: Tensor) -> Tensor:
        """Of right sides (D,K) and (7,K), without what the training's codes say: (D+7,K)."""
        found = self.gaussian.rest.double() * code
        own = torch.cholesky_solve(torch.cat([code[self.seen], similar]), self.factor)
        found[self.seen] = own[: len(self.seen)]
        return torch.cat([found, own[len(self.seen) :]])


def _factor(whole: Tensor) -> Tensor:
    """Cholesky's factor of a positive matrix of which float32 kept seven digits."""
    diagonal, factor = whole.diagonal().clone(), whole
    for share in ROUNDING:
        whole.diagonal().copy_(diagonal * (1 + share))
        factor, failed = torch.linalg.cholesky_ex(whole)
        if not failed:
            break
    return factor
