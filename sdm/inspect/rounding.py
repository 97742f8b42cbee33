"""Digits of coordinates that float32 does not hold: meshes far from the origin, such as those in UTM coordinates."""

from __future__ import annotations

import numpy as np

from sdm.core.mesh import TriangleMesh

# Steps of float32 along half of the edges, at least, and along the longest edge of the box of a mesh about which
# nothing is said without a look at its edges.
STEPS_IN_AN_EDGE, STEPS_IN_A_BOX = 64, 1 << 16


def lost_digits(mesh: TriangleMesh) -> list[str]:
    """Sentences, one at most, about a mesh so far from the origin that float32 rounds its shape.

    Args:
        mesh: On any device; a GPU is waited for.
    """
    low, high = mesh.bounds
    largest, size = float(np.abs([low, high]).max()), float((high - low).max())
    step = float(np.spacing(np.float32(largest)))
    if size >= STEPS_IN_A_BOX * step or size == 0:
        return []
    vertices, faces = mesh.numpy()
    corners = vertices[faces].astype(np.float64)
    edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2)))
    if edge >= STEPS_IN_AN_EDGE * step:
        return []
    text = (
        f"coordinates of up to {largest:.4g} have steps of {step:.2g} in float32, and the mesh is {size:.4g} long: its "
        "shape has lost digits; move it towards the origin before it becomes float32"
    )
    return [text]
