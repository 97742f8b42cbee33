"""Prior of codes: a Gaussian of those of the training shapes."""

from __future__ import annotations

from torch import Tensor

from sdm.deepsdf.networks.code_gaussian import CodeGaussian
from sdm.deepsdf.networks.model import DeepSDF


class CodePrior:
    """A Gaussian over codes, as its negative logarithm times two.

    Args:
        model: For the "published" variant the prior is the paper's: mean 0, the same variance along all axes. For the
            "local" one it is fitted to the codes of the training shapes (`CodeGaussian`).
    """

    def __init__(self, model: DeepSDF) -> None:
        self.start = model.codes.mean(0)
        self.learned = model.settings.variant != "published"
        if self.learned:
            self._gaussian = CodeGaussian(model.codes, model.settings.code_deviation**2)

    def __call__(self, codes: Tensor) -> Tensor:
        """Squared distances (B,) of codes (B,D) from the mean, in units of the variance."""
        if not self.learned:
            return codes.square().sum(1)
        return self._gaussian.squared_distance(codes)
