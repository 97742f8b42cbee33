"""Shape models of GIAS (gias3, J. Zhang et al.) and of packages that hold such files, for example articulated-ssm."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError
from sdm.shapes.models.statistical_shape import LIMIT, MOST_MODES, StatisticalShape

ARRAYS = ("mean", "weights", "modes")
NO_MODEL = "is not a GIAS shape model: give a .pc.npz file with the arrays mean (3V), weights (M), modes (3V, M)"
# Parts of the largest deviation, below which a mode of a part is rounding.
LEAST = 1e-6


def read_gias_model(
    path: Path, mean: TriangleMesh, *, vertices: slice | None = None, limit: float = LIMIT
) -> StatisticalShape:
    """The shape model of a .pc.npz file of principal components, whose arrays of objects are left alone.

    Args:
        path: The file: `mean` (3V), `weights` (M), which are variances, and `modes` (3V, M).
        mean: The mesh of the mean shape, for its faces, with the model's vertices in the model's order.
        vertices: The part of the model to take, all by default: one bone of several. Its faces are those whose corners
            all are in the part. The part's modes are orthonormal again, in the order of their deviations, and the part
            varies as it does in the whole.
        limit: See `StatisticalShape`.

    Raises:
        FormatError: The file cannot be read or is something else, or the mesh is not that of its mean.
    """
    arrays = _read(path)
    center, spread = arrays["mean"].reshape(-1, 3), arrays["modes"].T * np.sqrt(arrays["weights"])[:, None]
    if len(mean.vertices) != len(center):
        raise FormatError(
            f"{path} has {len(center):,} vertices, and the mesh of its mean {len(mean.vertices):,}: give the mesh that "
            "belongs to it"
        )
    begin, end, step = (vertices or slice(None)).indices(len(center))
    if step != 1 or end - begin < 4:
        raise FormatError(
            f"vertices {begin} to {end} of the {len(center):,} of {path} were requested: give a range of at least four"
        )
    faces = mean.faces.cpu().numpy()
    faces = faces[((faces >= begin) & (faces < end)).all(1)] - begin
    if not len(faces):
        raise FormatError(f"no face of the mean's mesh has all corners in the vertices {begin} to {end}")
    modes, deviations = _orthonormal(spread.reshape(len(spread), -1, 3)[:, begin:end])
    shares = np.cumsum(deviations**2) / max(float((deviations**2).sum()), np.finfo(np.float64).tiny)
    facts = {"source": path.name, "vertices": [begin, end], "compactness": shares.tolist()}
    return StatisticalShape(center[begin:end], modes, deviations, faces, limit=limit, facts=facts)


def _read(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name].astype(np.float64) for name in ARRAYS}
    except OSError as error:
        raise FormatError(f"{path} cannot be read: {error.strerror or error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path} {NO_MODEL}") from error
    mean, weights, modes = (arrays[name] for name in ARRAYS)
    if mean.ndim != 1 or mean.size % 3 or weights.ndim != 1 or modes.shape != (mean.size, weights.size):
        raise FormatError(f"{path} {NO_MODEL}, and these are {mean.shape}, {weights.shape} and {modes.shape}")
    if not all(np.isfinite(array).all() for array in arrays.values()) or (weights < 0).any():
        raise FormatError(f"{path} has a variance below zero, or a number that is not finite")
    if not 1 <= weights.size <= MOST_MODES:
        raise FormatError(f"{path} has {weights.size} modes; 1 to {MOST_MODES} are supported")
    return arrays


def _orthonormal(spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes (M,V,3) and deviations (M) of sum_k t_k spread_k, t normal: a turn of t leaves it normal."""
    _, deviations, modes = np.linalg.svd(spread.reshape(len(spread), -1), full_matrices=False)
    kept = deviations > LEAST * max(deviations[0], np.finfo(np.float64).tiny)
    kept[0] = True
    return modes[kept].reshape(-1, *spread.shape[1:]), deviations[kept]
