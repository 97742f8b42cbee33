"""Files of points: what a scanner or a segmentation leaves of a surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def points_of(path: Path) -> tuple[Any, Any]:
    """Points of a mesh's vertices, a point cloud or a .npy file.

    Returns:
        Points (N,3), and their normals (N,3) where a .npy file has six columns, else None.

    Raises:
        SDMError: It cannot be read, or holds no points.
    """
    import numpy as np

    from sdm.errors import FormatError, MeshError
    from sdm.io import load_mesh

    if path.is_dir():
        raise FormatError(f"{path} is a folder; give a file of points")
    if not path.is_file():
        raise FormatError(f"{path} cannot be read: no such file")
    if path.suffix.lower() == ".npy":
        try:
            points = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FormatError(f"{path} is no .npy file of numbers") from error
        if points.ndim != 2 or points.shape[1] not in (3, 6) or points.dtype.kind not in "fiu":
            held = f"{points.dtype} of shape {points.shape}"
            raise FormatError(f"{path} holds {held}; (N, 3), or (N, 6) with normals, is needed")
        return points[:, :3], points[:, 3:] if points.shape[1] == 6 else None
    try:
        return load_mesh(path).vertices, None
    except MeshError as error:
        # A scan has points and no triangles.
        if "no triangles" not in str(error):
            raise
    import trimesh

    try:
        cloud = trimesh.load(path, process=False)
        return np.asarray(cloud.vertices, dtype=np.float64), None  # pyright: ignore[reportAttributeAccessIssue]
    except Exception as error:
        raise FormatError(f"{path} cannot be read as points: {type(error).__name__}") from error
