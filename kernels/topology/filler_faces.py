"""Faces of no area behind a mesh's own, so that meshes with other numbers of faces look alike to a recorded call."""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# Entries of the counts: faces and vertices of the mesh.
FACES, VERTICES, COUNTS = 0, 1, 2


@wp.kernel
def _fill_up(
    begin: int,
    counts: wp.array(dtype=wp.int32),
    given: wp.array2d(dtype=wp.int32),
    faces: wp.array2d(dtype=wp.int32),
    wrong: wp.array(dtype=wp.int32),
):
    face = begin + wp.tid()
    last = counts[VERTICES] - 1
    # Each at a vertex of its own, as far as there are enough, so that none has many.
    filler = face % counts[VERTICES]
    for k in range(3):
        index = filler
        if face < counts[FACES]:
            index = wp.clamp(given[face, k], 0, last)
            if index != given[face, k]:
                wrong[0] = 1
        faces[face, k] = index


def fill_up(counts: wp.array, given: wp.array, faces: wp.array, wrong: wp.array) -> None:
    """Copy a mesh's faces, and put faces of no area behind them.

    Args:
        counts: (COUNTS) int32, the faces and vertices that there are.
        given: (F,3) int32, of which the first are the mesh's.
        faces: (F,3) int32, filled: indices out of range are brought into it.
        wrong: (1) int32, set to 1 if there were any.
    """
    launch(_fill_up, faces.shape[0], [counts, given, faces, wrong], faces.device)
