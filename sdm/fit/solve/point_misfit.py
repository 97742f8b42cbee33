"""Misfit of points: what of their distances from a fitted shape neighbours have alike, as noise has not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    import numpy as np

# Misfit in standard deviations of what neighbours do not have alike, from which on intervals are too narrow.
MOST_MISFIT = 0.5
# In standard errors of the neighbours' covariance, where there is none.
SURE = 4.0
# Of the shape's extent, below which facets and rounding explain it.
LEAST = 1e-3


def shared_distance(feet: Tensor, distances: Tensor, noise: float) -> float:
    """Root mean square of what nearest neighbours' distances have alike; 0 if independent noise explains them.

    Args:
        feet: (N,3) closest places of the shape: of the points themselves those on one side are nearer to each other.
        distances: (N,) signed distances from the fitted shape.
        noise: Their standard deviation by the median: of outliers no more counts than 2.5 times that.

    The covariance of a point's distance with its nearest neighbour's is that of the model's error, as independent noise
    adds nothing to it (P. A. P. Moran, Biometrika 37, 1950).
    """
    import numpy as np
    from scipy.spatial import KDTree

    places, first = np.unique(feet.double().cpu().numpy(), axis=0, return_index=True)
    if len(places) < 3:
        return 0.0
    own: np.ndarray = distances.double().cpu().numpy()[first]
    most = 2.5 * noise
    own = own.clip(-most, most)
    nearest = np.asarray(KDTree(places).query(places, k=2)[1])[:, 1]
    shared, all_of_it = float((own * own[nearest]).mean()), float((own**2).mean())
    alone = math.sqrt(max(all_of_it - shared, 0.0))
    found = math.sqrt(max(shared, 0.0))
    extent = float((places.max(0) - places.min(0)).max())
    sure = shared > SURE * all_of_it / math.sqrt(len(places))
    return found if sure and found > MOST_MISFIT * alone and found > LEAST * extent else 0.0
