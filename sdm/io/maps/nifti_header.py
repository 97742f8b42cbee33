"""Header of a NIfTI map: the bytes that nibabel writes, without an image of its own for each map.

nibabel sets the affine three times, each time by a singular value decomposition and an eigenvector: 600 calls of
functions, 2.6 ms with Python's lock, for which all threads wait that read and write maps. What is the same for all maps
of a shape is made by nibabel once here, and so is the quaternion of each rotation.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import nibabel as nib
import numpy as np
from nibabel.quaternions import mat2quat

# NIfTI-1 counts voxels with 16 bits.
LARGEST_NIFTI_1 = 32767
# NIfTI's number of a comment, the bytes of an extension before its content, and what its size is a multiple of.
COMMENT, BEFORE, WHOLE = 6, 8, 16
EXTENDED = b"\1\0\0\0"


def nifti_header(affine: np.ndarray, shape: tuple[int, int, int], comment: bytes, space: int) -> bytes:
    """All that is before the values of a map, float32.

    Args:
        affine: (4,4) float64, from voxels to mm.
        shape: Voxels along x, y and z.
        comment: Of the one extension.
        space: NIfTI's number of the space that the affine leads to.
    """
    # Fields lie in memory as they do in the file.
    fields = _template(shape, space).copy()
    for name, row in zip(("srow_x", "srow_y", "srow_z"), affine[:3], strict=True):
        fields[name] = row
    for name, value in zip(("qoffset_x", "qoffset_y", "qoffset_z"), affine[:3, 3], strict=True):
        fields[name] = value
    columns = affine[:3, :3]
    lengths = np.sqrt(np.sum(columns * columns, axis=0))
    fields["pixdim"][1:4] = lengths
    turn = _quaternion((columns / lengths).tobytes())
    fields["pixdim"][0], fields["quatern_b"], fields["quatern_c"], fields["quatern_d"] = turn
    size = -(-(len(comment) + BEFORE) // WHOLE) * WHOLE
    fields["vox_offset"] = fields.nbytes + len(EXTENDED) + size
    extension = np.array((size, COMMENT), np.int32).tobytes() + comment
    return fields.tobytes() + EXTENDED + extension.ljust(size, b"\0")


@lru_cache(64)
def _template(shape: tuple[int, int, int], space: int) -> Any:
    """Fields that do not depend on where a map lies."""
    large = max(shape) > LARGEST_NIFTI_1
    values = np.broadcast_to(np.float32(0), shape)
    image: Any = (nib.Nifti2Image if large else nib.Nifti1Image)(values, np.eye(4))
    image.header.set_xyzt_units("mm", "unknown")
    image.header["descrip"] = b"signed distance, negative inside"
    image.header.set_intent("estimate", name="distance")
    image.set_sform(np.eye(4), space)
    image.set_qform(np.eye(4), space)
    image.update_header()
    image.header.set_slope_inter(1.0, 0.0)
    return image.header.structarr


@lru_cache(64)
def _quaternion(direction: bytes) -> tuple[float, float, float, float]:
    """NIfTI's sign of the third axis, and b, c and d of the quaternion, of unit columns (3,3) float64 as bytes."""
    columns = np.frombuffer(direction).reshape(3, 3).copy()
    sign = 1.0 if np.linalg.det(columns) > 0 else -1.0
    columns[:, 2] *= sign
    # Their nearest rotation.
    left, _, right = np.linalg.svd(columns)
    _, b, c, d = mat2quat(left @ right)
    return sign, float(b), float(c), float(d)
